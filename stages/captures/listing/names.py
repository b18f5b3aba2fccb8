"""Names of files in a capture: their order, and how a path in a file of cameras leads to a picture.

Names on disk may differ from those in a file in their Unicode form: macOS decomposes letters with accents, other systems compose them.
"""

from __future__ import annotations

import os
import posixpath
import re
import unicodedata
from collections.abc import Iterable, Iterator, Sequence
from fractions import Fraction
from pathlib import Path

from ....pipeline import CaptureError
from ....pipeline.names import composed

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".jpe", ".jfif", ".webp", ".bmp", ".tif", ".tiff")
VIDEO_SUFFIXES = (
    *(".mp4", ".mov", ".mkv", ".webm", ".avi", ".m4v", ".mpg", ".mpeg", ".ts", ".gif"),
    *(".mts", ".m2ts", ".m2t", ".3gp", ".3g2", ".wmv", ".asf", ".mxf", ".flv", ".ogv", ".vob", ".dv", ".m2v", ".y4m"),
    *(".h264", ".264", ".h265", ".265", ".hevc", ".mjpeg", ".mjpg", ".ivf"),
)
_DECIMAL = re.compile(r"(\D*)(\d+)\.(\d+)(\.\D\w*)?")
_FORMS = ("NFC", "NFD")
_MOST_ENTRIES = 50_000  # that `elsewhere` looks at
_MOST_DEEP = 8


def natural_key(name: str) -> tuple[tuple[int, int, str], ...]:
    """Sort key by which `2.png` comes before `10.png`. Names that differ only in leading zeros are in plain order."""
    parts = re.findall(r"\d+|\D+", name)
    key = [(0, int(p), "") if p.isdecimal() and p.isascii() and len(p) < 4000 else (1, 0, p) for p in parts]
    return (*key, (-1, 0, name))


def in_order(names: Iterable[str]) -> list[str]:
    """Names in natural order. If the pictures among them are decimal numbers, as `0.03.png` and `0.1.png`, they are ordered by value."""
    names = list(names)
    if not by_value(names):
        return sorted(names, key=natural_key)
    return sorted(names, key=lambda name: (_value(name) if is_image(name) else (), natural_key(name)))


def by_value(names: Iterable[str]) -> bool:
    """Whether the pictures among `names` are decimal numbers whose order by value is not the natural one. All must have the form
    number.number, with one text before it, or none. A counter after a point (1.9, 1.10) is no decimal number: those have no zero at the
    end, unless all have as many digits, and then both orders are one."""
    pictures = [name for name in names if is_image(name)]
    found = [_DECIMAL.fullmatch(name) for name in pictures]
    parts = [match.groups() for match in found if match is not None]
    if len(parts) < len(pictures) or len({(before, after) for before, _, _, after in parts}) != 1:
        return False
    fractions = [fraction for _, _, fraction, _ in parts]
    return len(set(map(len, fractions))) > 1 and not any(f.endswith("0") and len(f) > 1 for f in fractions)


def decimal_of(names: Sequence[str]) -> list[Fraction] | None:
    """The decimal numbers that `names` of pictures are; None if they are none, or may be counters after a point (1.9, 1.10)."""
    found = [_DECIMAL.fullmatch(posixpath.basename(name)) for name in names]
    parts = [match.groups() for match in found if match is not None]
    if len(parts) < len(names) or len({(posixpath.dirname(name), p[0], p[3]) for name, p in zip(names, parts, strict=True)}) != 1:
        return None
    if len({len(p[2]) for p in parts}) > 1 and not by_value([posixpath.basename(name) for name in names]):
        return None
    return [Fraction(int(p[1] + p[2]), 10 ** len(p[2])) for p in parts]


def _value(name: str) -> tuple[int, str]:
    """Sorts decimal numbers exactly: the fraction digit by digit."""
    match = _DECIMAL.fullmatch(name)
    assert match is not None, "by_value has matched it"
    return int(match[2]), match[3]


def is_image(name: str) -> bool:
    return name.lower().endswith(IMAGE_SUFFIXES)


def is_video(name: str) -> bool:
    return name.lower().endswith(VIDEO_SUFFIXES)


def resolve_inside(root: Path, name: str, where: str) -> Path:
    """`root/name` with links resolved. Refuses paths that lead out of the capture; an absolute one may lead into it. Links may lead
    anywhere, since a capture is only read and people link to files that are too big to copy."""
    inside = relative(root, name, where)
    try:
        return (root / on_disk(root, inside)).resolve()
    except (OSError, RuntimeError, ValueError) as error:
        raise CaptureError(f"{where}: the path {name[:200]!r} cannot be followed ({error}); correct it") from error


def relative(root: Path, name: str, where: str) -> str:
    """`name` as a plain path relative to `root`, with `/` between folders. Raises CaptureError if it leads out of the capture."""
    plain = name.replace("\\", "/") if re.match(r"[A-Za-z]:|\\", name) else name
    normal = posixpath.normpath(plain)
    if "\0" not in name and posixpath.isabs(normal):
        for base in (str(root), os.path.realpath(root)):
            for path in (normal, os.path.join(os.path.realpath(posixpath.dirname(normal)), posixpath.basename(normal))):
                if path.startswith(base.rstrip("/") + "/"):
                    return path[len(base.rstrip("/")) + 1 :]
    if plain.startswith(("/", "~")) or re.match(r"[A-Za-z]:", name) or normal == ".." or normal.startswith("../") or "\0" in name:
        raise CaptureError(f"{where}: the path {name[:200]!r} leaves the capture; use a path relative to {root}")
    return normal


def on_disk(root: Path, name: str) -> str:
    """The relative path `name` with each part in the Unicode form (composed or decomposed) in which it exists; `name` if none does."""
    if name.isascii() or _exists(root / name):
        return name
    found: list[str] = []
    for part in name.split("/"):
        forms = [part, *(unicodedata.normalize(form, part) for form in _FORMS)]  # type: ignore[arg-type]
        found.append(next((form for form in forms if _exists(root.joinpath(*found, form))), part))
    return "/".join(found)


def find_image(root: Path, name: str, where: str) -> str:
    """Path relative to `root` of the image called `name`. Its extension may be missing, and `\\` counts as `/`."""
    found = seek_image(root, name, where)
    if found is None:
        other = elsewhere(root, name)
        raise CaptureError(
            f"{where}: no image {name[:200]!r} in {root}; "
            + (f"a file of that name is {other}: correct the path" if other else "add the file or remove the frame")
        )
    return found


def seek_image(root: Path, name: str, where: str) -> str | None:
    """Like `find_image`, but returns None if there is no such image. Raises CaptureError if the path leaves the capture."""
    name = name.replace("\\", "/")
    resolve_inside(root, name, where)
    return _image_at(root, relative(root, name, where))


def elsewhere(root: Path, name: str) -> str | None:
    """Path relative to `root` of the one picture in the capture that has the file name of `name`, in whatever folder; None if there is
    none or several. For messages: the search looks at up to 50,000 files."""
    wanted = composed(posixpath.basename(name.replace("\\", "/")))
    found = None
    for path in _walk(root):
        own = composed(posixpath.basename(path))
        if is_image(path) and wanted in (own, posixpath.splitext(own)[0]):
            if found is not None:
                return None
            found = path
    return found


def _walk(root: Path) -> Iterator[str]:
    left, waiting = _MOST_ENTRIES, [("", 0)]
    while waiting:
        folder, deep = waiting.pop()
        try:
            with os.scandir(root / folder) as entries:
                for entry in entries:
                    left -= 1
                    path = f"{folder}/{entry.name}".lstrip("/")
                    if left < 0:
                        return
                    if entry.name.startswith("."):
                        continue
                    if entry.is_dir(follow_symlinks=False):
                        if deep < _MOST_DEEP:
                            waiting.append((path, deep + 1))
                    else:
                        yield path
        except OSError:  # nothing can be read from it
            continue


def _image_at(root: Path, normal: str) -> str | None:
    normal = on_disk(root, normal)
    suffixes = [s for suffix in IMAGE_SUFFIXES for s in (suffix, suffix.upper())]
    for candidate in (normal, *(normal + suffix for suffix in suffixes)):
        candidate = on_disk(root, candidate)
        try:
            found = (root / candidate).is_file()
        except (OSError, ValueError):
            found = False
        if found:
            return candidate
    return None


def _exists(path: Path) -> bool:
    try:
        return os.path.lexists(path)
    except (OSError, ValueError):
        return False
