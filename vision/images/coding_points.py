"""What coded colours mean by the numbers of H.273, and the conversion of PNG pictures that have them, as frames of HDR video that FFmpeg
wrote do (cICP chunk)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .wide_colour import HLG_PEAK, WHITE, Curve, Gamut, to_sdr

if TYPE_CHECKING:
    from PIL.Image import Image

# Values of ITU-T H.273.
UNSPECIFIED = (0, 2)
_CURVES: dict[int, Curve] = {16: "PQ", 18: "HLG"}
_GAMUTS: dict[int, Gamut] = {9: "BT.2020", 11: "P3", 12: "P3"}  # 11, of cinemas, is 12 with a greener white, which is shown as white
UNREAD_GAMUTS = {4: "BT.470 M", 8: "film", 10: "CIE XYZ"}
UNREAD_CURVES = {8: "linear", 9: "logarithmic", 10: "logarithmic", 17: "SMPTE 428"}


@dataclass(frozen=True)
class CodingPoints:
    """How the colours of a picture or a video are coded. transfer, primaries: numbers of H.273; 2 if unspecified."""

    transfer: int = 2
    primaries: int = 2

    @property
    def curve(self) -> Curve:
        return _CURVES.get(self.transfer, "SDR")

    @property
    def gamut(self) -> Gamut:
        if self.primaries in UNSPECIFIED and self.curve != "SDR":
            return "BT.2020"
        return _GAMUTS.get(self.primaries, "BT.709")

    @property
    def is_plain(self) -> bool:
        """SDR with the primaries of BT.709 or close to them: the codes are used as they are."""
        return self.curve == "SDR" and self.gamut == "BT.709"

    def conversion(self, its: str) -> str | None:
        """A line about what is converted; None if the colours are plain. its: "its" or "the"."""
        if self.is_plain:
            return None
        if self.curve == "SDR":
            return f"{its} wide gamut ({self.gamut}) is converted to that of sRGB (BT.709); what lies outside is clipped"
        shown = f", shown at {HLG_PEAK:.0f} cd/m2" if self.curve == "HLG" else ""
        return f"HDR ({self.curve}{shown}, {self.gamut}) is converted to SDR (sRGB, BT.709); {WHITE:.0f} cd/m2 becomes white"


@dataclass(frozen=True)
class Coding(CodingPoints):
    """What a cICP chunk says. full: whether black is 0 and white the largest code."""

    full: bool = True

    @property
    def told(self) -> str | None:
        """A line about what is done with the colours; None if they are used as they are."""
        said = [line for line in (self.conversion("the"),) if line]
        if self.transfer in UNREAD_CURVES:
            said.append(f"the transfer curve ({UNREAD_CURVES[self.transfer]}) is not converted, so the contrast is another")
        if self.primaries in UNREAD_GAMUTS:
            said.append(f"the primaries ({UNREAD_GAMUTS[self.primaries]}) are not converted, so the colours are others")
        if not self.full:
            said.append("the limited range is not converted, so the contrast is lower; write the PNG files with full range")
        return "; ".join(said) or None


def coding_of(chunk: bytes | None) -> Coding | None:
    """chunk: the data of cICP. None if there is none, or if it leaves open what the colours are, so that a profile may say it."""
    if chunk is None or len(chunk) != 4 or (chunk[0] in UNSPECIFIED and chunk[1] in UNSPECIFIED):
        return None
    return Coding(transfer=chunk[1], primaries=chunk[0], full=bool(chunk[3]))


def converted(image: Image, coding: Coding) -> Image:
    """``image``, decoded, coded as sRGB: RGB, or RGBA if it has alpha, which stays; itself if its colours are used as they are."""
    from PIL import Image as pillow

    if coding.is_plain:
        return image
    if image.mode.startswith("I;16"):
        grey = np.asarray(image).astype(np.uint16)
        return pillow.fromarray(to_sdr(np.repeat(grey[..., None], 3, axis=2), coding.curve, coding.gamut))
    codes = np.asarray(image.convert("RGB")).astype(np.uint16)
    colours = pillow.fromarray(to_sdr(codes, coding.curve, coding.gamut, white=255))
    if "A" not in image.getbands() and "transparency" not in image.info:
        return colours
    return pillow.merge("RGBA", (*colours.split(), image.convert("RGBA").getchannel("A")))
