"""Image files that hold several pictures, of which only the first would be read: animated WebP and PNG, TIFF of several pages."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from ....vision.images.files import BadImageError, open_image

_KINDS = {"WEBP": "an animated WebP", "PNG": "an animated PNG (APNG)", "TIFF": "a TIFF of several pages"}  # MPO's others are previews
_SUFFIXES = (".webp", ".png", ".tif", ".tiff")
_CODE = (
    "import os, sys; from PIL import Image, ImageSequence as S; os.makedirs(sys.argv[2]); "
    '[p.save(f"{sys.argv[2]}/{i:04d}%s") for i, p in enumerate(S.Iterator(Image.open(sys.argv[1])))]'
)


class Several(NamedTuple):
    """What a file with several pictures is, and how many of them it shows a second, if it says so."""

    words: str
    rate: float | None


def several(file: Path) -> Several | None:
    """None for a file with one picture, or a smaller copy of it besides; and for one that cannot be read."""
    if not file.name.lower().endswith(_SUFFIXES):
        return None
    try:
        with open_image(file) as image:
            count = getattr(image, "n_frames", 1)
            if image.format not in _KINDS or count < 2 or not _is_alike(image):
                return None
            about: Any = image.info
            duration = about.get("duration")  # ms
            rate = 1000 / duration if isinstance(duration, int | float) and duration > 0 else None
            return Several(f"{_KINDS[image.format]} with {count} pictures", rate)
    except BadImageError:
        return None


def _is_alike(image: Any) -> bool:
    """Whether the second picture has the size of the first: that of a TIFF may be its preview."""
    size = image.size
    image.seek(1)
    if image.format != "TIFF":
        image.load()  # only then its duration is known
    return image.size == size


def apart(file: Path, found: Several) -> str:
    """Why a file with several pictures is no capture, and the command that makes one of it."""
    folder = file.with_name(f"{file.stem}-pictures")
    code = _CODE % (".tif" if "TIFF" in found.words else ".png")
    command = " ".join(shlex.quote(word) for word in (sys.executable, "-c", code, str(file), str(folder)))
    rate = f" with --set frames.fps={found.rate:.4g}" if found.rate else ""
    return f"{file.name}: {found.words}, which is not read; make a folder of pictures of it, and pass {folder}{rate}: {command}"


def told(root: Path, names: Sequence[str]) -> tuple[str, ...]:
    """A line about those of `names`, paths relative to `root`, that hold several pictures."""
    there = [name for name in names if several(root / name) is not None]
    if not there:
        return ()
    many = "1 file holds" if len(there) == 1 else f"{len(there)} files hold"
    return (
        f"{many} several pictures (first {there[0]}), of which only the first is read; make a folder of single pictures if all are meant",
    )
