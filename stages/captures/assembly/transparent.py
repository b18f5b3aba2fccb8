"""What the alpha channel of a capture's pictures says: nothing, where it is opaque everywhere, as Blender and Unreal write it."""

from __future__ import annotations

from pathlib import Path

from ....pipeline.choice.evenly import evenly
from ....vision.images.files import BadImageError, open_image
from .. import checks
from ..listing.unread import MASK_PLACES
from ..reading import Reading

_SILHOUETTES = ("dnerf",)
_JUDGED = 8  # pictures; one of 12 megapixels takes about as long to decode as the headers of thousands to read


def judge_alpha(root: Path, reading: Reading, kind: str, background: str | None) -> None:
    """Clears `Reading.alpha` where no pixel of a sample of the pictures is transparent, and says so: those are RGB, without
    silhouettes. Looks at pictures from the whole capture, and at no more once one has a transparent pixel.

    Else says what transparent pixels are taken for, except in the layout whose pictures are silhouettes by custom. background: see
    `Options`."""
    if not reading.alpha or reading.videos:
        return
    files = list(dict.fromkeys(str(shot.file) for shot in reading.shots))
    files = [file for file in files if checks.image_header(root, file)[2]]
    judged = evenly(files, _JUDGED)
    if not files:
        return
    if not any(_shows_through(root / file) for file in judged):
        reading.alpha = False
        of = "" if len(judged) == len(files) else f" (judged by {len(judged)} of them, from first to last)"
        told = f"{len(files)} pictures have an alpha channel" if len(files) > 1 else f"{files[0]} has an alpha channel"
        reading.notes += (f"{told} that is opaque everywhere{of}, so it is not used",)
    elif kind not in _SILHOUETTES:
        reading.notes += (
            f"transparent pixels ({len(files)} of {len(reading.shots)} pictures have alpha) are taken for empty space, shown on "
            f"{background or 'white'} (frames.background). If they only hide what is there, save the pictures without alpha, and masks "
            f"that are black there; masks are read from {MASK_PLACES}",
        )


def _shows_through(path: Path) -> bool:
    """Whether a picture has a pixel that is not opaque. A file that cannot be decoded has none; the stage `frames` refuses it."""
    try:
        with open_image(path) as image:
            if "A" not in image.getbands():
                image = image.convert("RGBA")
            return any(image.getchannel("A").histogram()[:255])
    except BadImageError:
        return False
