"""Paths on the command line: none is empty, a workspace is no file, and nothing is written over a capture."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path, PosixPath

import typer

from ...pipeline import SettingsError

DIGITS = (".4dgs", ".3ds", ".3mf", ".3gp", ".7z")  # endings of files that begin with a digit
FOLDERS = "a folder exists, is typed with a / at its end, or has no ending"


def typed_path(text: str | Path) -> Path:
    """A path as it was typed. An empty one, often a shell variable without a value, would mean the current folder, so it is refused. In
    --out=~/x a shell leaves the ~ as it is."""
    if not str(text).strip():
        raise typer.BadParameter("the name is empty; give one, or . for the current folder")
    try:
        return Path(text).expanduser()
    except RuntimeError as error:
        raise typer.BadParameter(f"{text}: there is no such user; for a name that begins with ~ give the whole path") from error


class NamedFolder(PosixPath):
    """A path that was typed with a slash at its end, so that it means a folder, whatever its ending. Others forget the slash."""


def typed_output(text: str | Path) -> Path:
    """`typed_path`, which remembers a slash at its end."""
    path = typed_path(text)
    return NamedFolder(path) if isinstance(text, NamedFolder) or str(text).endswith("/") else path


def is_folder(path: Path) -> bool:
    """Whether a path for results means a folder: it is one, was typed with a slash at its end, or has no ending of a file. An ending that
    begins with a digit is a version or a date (v1.2, take.2026-11-30), unless files are known to have it."""
    ending = path.suffix.lower()
    return path.is_dir() or isinstance(path, NamedFolder) or not ending or (ending[1].isdigit() and ending not in DIGITS)


def check_workspace(workspace: Path) -> None:
    """Raises SettingsError if the workspace is a file, or lies below one."""
    whole = workspace.resolve()
    place = next(place for place in (whole, *whole.parents) if os.path.exists(place))
    if not place.is_dir():
        raise SettingsError(f"--workspace {workspace}: {place} is a file, not a folder; give another --workspace")


def check_output(option: str, out: Path, capture: Path, workspace: Path) -> None:
    """Raises SettingsError if writing to ``out``, the value of ``option``, would change the capture: if it is one of its files, also one
    that only a link in its folder leads to, or lies in its folder. A workspace in that folder may be written to."""
    if not _touches(out, capture, workspace):
        return
    name = out.resolve().name
    others = (folder / name for folder in (Path(), workspace, capture.resolve().parent))
    free = next((other for other in others if not other.exists() and not _touches(other, capture, workspace)), None)
    instead = "name a place outside of it" if free is None else f"{option} {free} would do"
    raise SettingsError(f"{option} {out}: this would change the capture {capture}, which is never written to; {instead}")


def _touches(out: Path, capture: Path, workspace: Path) -> bool:
    whole, place = capture.resolve(), out.resolve()
    places = {place, out.parent.resolve() / out.name}  # what a link leads to, and the link itself, which a new file would replace
    if not whole.is_dir():
        return whole in places
    own = workspace.resolve()
    if own == whole:
        own /= "scenes"  # the workspace has nothing else there that an output belongs to
    if own.is_relative_to(whole) and place.is_relative_to(own):
        return False
    if any(place.is_relative_to(whole) for place in places):
        return True
    return any(place.is_relative_to(target) or place == target.parent for target in _linked(whole, own))


def _linked(folder: Path, skipped: Path) -> Iterator[Path]:
    """Files and folders elsewhere that links in ``folder`` lead to, also links behind links; not those in ``skipped``."""
    waiting, seen = [folder], {folder}
    while waiting:
        for where, folders, files in os.walk(waiting.pop()):
            folders[:] = [name for name in folders if Path(where, name) != skipped]
            for path in (Path(where, name) for name in (*folders, *files) if os.path.islink(os.path.join(where, name))):
                target = path.resolve()
                if target not in seen:
                    seen.add(target)
                    yield target
                    if target.is_dir():
                        waiting.append(target)
