"""Poses in files whose names do not tell them, but their content does: those that are named like the picture beside them, and tables and
documents that photogrammetry writes under any name; and the log curve of a video in such a file."""

from __future__ import annotations

import posixpath
import re
from collections.abc import Sequence
from pathlib import Path

from .names import is_image

_MARK = b"\xef\xbb\xbf"  # some programs begin text with it
_HEAD = 1 << 16  # bytes that are looked at; such a file has a few thousand
_WORDS = {
    ".xmp": (b"xcr:Rotation",),  # of RealityCapture; those of Lightroom hold settings
    ".json": (b'"cameraPoseARFrame"', b'"intrinsics"'),  # of 3D Scanner App
}
_BEGINNINGS = {  # of tables of poses: of RealityCapture, Metashape (the reference, and angles), Pix4D; and of documents of Metashape and of
    # ContextCapture
    **dict.fromkeys(
        (".csv", ".txt"),
        re.compile(
            rb"(#\s*cameras?\b.*\n)?#\s*name[,;\t ]+(x|lat)|(#.*\n)*#\s*(label|photoid)[,;\t ]+(x|lon|lat)|imagename\s+x\s+y\s+z\s", re.I
        ),
    ),
    ".xml": re.compile(rb"(<\?xml[^>]*>)?\s*(<!--.*?-->\s*)*(<document\b[^>]*>\s*<chunks?\b|<blocksexchange\b)", re.I | re.S),
}
_GAMMA = re.compile(rb'name="CaptureGammaEquation"\s{1,9}value="([A-Za-z0-9._-]{1,40})"')
_MOST_TABLES = 200  # files that are opened; captures have one or two


def posed_tables(root: Path, files: Sequence[str]) -> set[str]:
    """Those of `files`, relative to `root`, that hold the poses of many pictures in a form of another program, under any name."""
    tables = [path for path in files if path.lower().endswith(tuple(_BEGINNINGS))]
    tables = sorted(tables, key=lambda path: path.lower().endswith(".txt"))[:_MOST_TABLES]  # some captures have a text for each picture
    return {path for path in tables if _BEGINNINGS[posixpath.splitext(path)[1].lower()].match(_head(root / path).removeprefix(_MARK))}


def log_curve(root: Path, name: str) -> tuple[str, str] | None:
    """The file that Sony's cameras write beside the video ``name`` (C0001M01.XML of C0001.MP4) and the log curve that it names; None if
    none. It is only searched for that field, so it may hold anything."""
    for suffix in ("M01.XML", "m01.xml"):
        file = posixpath.splitext(name)[0] + suffix
        if (found := _GAMMA.search(_head(root / file))) and b"log" in found[1].lower():
            return file, found[1].decode("ascii")
    return None


def posed_sidecars(root: Path, files: Sequence[str]) -> set[str]:
    """Those of `files`, relative to `root`, that have the name of a picture beside them and hold its pose or its camera."""
    beside = [path for path in files if path.lower().endswith(tuple(_WORDS))]
    if not beside:
        return set()
    stems = {posixpath.splitext(path)[0].lower() for path in files if is_image(path)}
    return {path for path in beside if posixpath.splitext(path)[0].lower() in stems and _holds_pose(root / path)}


def _holds_pose(file: Path) -> bool:
    head = _head(file)
    return any(word in head for word in _WORDS[file.suffix.lower()])


def _head(file: Path) -> bytes:
    """Its first bytes; none if it cannot be read."""
    try:
        if not file.is_file():  # reading a pipe would block
            return b""
        with file.open("rb") as opened:
            return opened.read(_HEAD)
    except OSError:
        return b""
