"""Converts photos whose files say that their colours are others than sRGB to sRGB, as browsers and viewers show them."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from io import BytesIO
from typing import TYPE_CHECKING, NamedTuple

from .coding_points import coding_of, converted
from .files import CODING

if TYPE_CHECKING:
    from PIL.Image import Image
    from PIL.ImageCms import ImageCmsTransform

MOST_BYTES = 1 << 22  # of a profile; those of printers have a megabyte or two
SAME = 2  # levels of 255; profiles that change no colour by more are sRGB under another name
STEPS = (0, 64, 128, 192, 255)  # levels of each channel at which this is tried


class Conversion(NamedTuple):
    """name: of the profile, for people. transform: to sRGB; None if the profile cannot be read, which ``name`` then says."""

    name: str
    transform: ImageCmsTransform | None


def in_srgb(image: Image, say: Callable[[str], None]) -> Image:
    """``image``, decoded, with its colours as its file means them, coded as sRGB; itself if it has no profile or one like sRGB. A grey
    or printed image becomes RGB then. Alpha stays. A cICP chunk outranks a profile, as PNG says. say: called with what was done."""
    if (coding := coding_of(image.info.get(CODING))) is not None:
        if coding.told is not None:
            say(coding.told)
        return converted(image, coding)
    conversion = _conversion_of(image)
    if conversion is None:
        return image
    if conversion.transform is None:
        say(f"colours are taken as sRGB, in spite of {conversion.name}")
        return image
    say(f"colours are converted from {conversion.name} to sRGB")
    from PIL import Image as pillow
    from PIL import ImageCms

    colours = ImageCms.applyTransform(image.convert(_colours(image.mode)), conversion.transform)
    assert colours is not None
    if "A" not in image.getbands() and "transparency" not in image.info:
        return colours
    return pillow.merge("RGBA", (*colours.split(), image.convert("RGBA").getchannel("A")))


def _conversion_of(image: Image) -> Conversion | None:
    """How ``image``, from `open_image`, is converted; None if it has no profile or one like sRGB."""
    profile = image.info.get("icc_profile")
    if not profile or not isinstance(profile, bytes) or image.mode.startswith(("I", "F")):
        return None
    if len(profile) > MOST_BYTES:
        return Conversion(f"a profile of {len(profile) >> 20} MB, more than {MOST_BYTES >> 20}", None)
    return _conversion(profile, _colours(image.mode))


def _colours(mode: str) -> str:
    """The mode whose channels a profile speaks of."""
    return "CMYK" if mode == "CMYK" else "L" if mode in ("1", "L", "LA") else "RGB"


@lru_cache(64)
def _conversion(profile: bytes, mode: str) -> Conversion | None:
    from PIL import Image as pillow
    from PIL import ImageCms

    try:
        own = ImageCms.ImageCmsProfile(BytesIO(profile))
        name = " ".join(ImageCms.getProfileDescription(own).split())[:60] or "a profile without a name"
        transform = ImageCms.buildTransform(own, ImageCms.createProfile("sRGB"), mode, "RGB", ImageCms.Intent.RELATIVE_COLORIMETRIC)
    except (ImageCms.PyCMSError, ValueError, OSError) as error:
        return Conversion(f"a profile that cannot be read ({error})", None)
    bands = len(pillow.new(mode, (1, 1)).getbands())
    levels = [bytes((a, b, c, 0)[:bands]) for a in STEPS for b in STEPS for c in STEPS]
    tried = pillow.frombytes(mode, (len(levels), 1), b"".join(levels))
    meant = ImageCms.applyTransform(tried, transform)
    assert meant is not None
    plain, changed = tried.convert("RGB").tobytes(), meant.tobytes()
    return Conversion(name, transform) if max(abs(a - b) for a, b in zip(plain, changed)) > SAME else None
