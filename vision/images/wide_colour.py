"""Converts pictures with high dynamic range or a wide gamut to SDR pictures with BT.709 primaries, coded as sRGB.

HDR: ITU-R BT.2100 (HLG with the system gamma 1.2 of a 1000 cd/m2 display; PQ). Diffuse white is 203 cd/m2 (ITU-R BT.2408) and becomes
white. Light up to 90 % of it stays as it is, so that a picture comes out as an SDR camera beside it records it; brighter light is
compressed into the rest, all three channels by one factor, so that hues stay. Gamuts: linear light, matrices from the primaries'
chromaticities (ITU-R BT.2087 for BT.2020), channels outside BT.709 are clipped.
"""

from __future__ import annotations

from functools import cache
from typing import Literal

import numpy as np

Curve = Literal["HLG", "PQ", "SDR"]
Gamut = Literal["BT.709", "BT.2020", "P3"]

WHITE = 203.0  # cd/m2 of diffuse white
HLG_PEAK, HLG_GAMMA = 1000.0, 1.2  # of the display for which HLG is shown, cd/m2
PQ_PEAK = 10000.0  # cd/m2
KNEE = 0.9  # of diffuse white; darker light is not changed
_D65 = (0.3127, 0.3290)
_PRIMARIES: dict[str, tuple[tuple[float, float], ...]] = {
    "BT.709": ((0.640, 0.330), (0.300, 0.600), (0.150, 0.060)),
    "BT.2020": ((0.708, 0.292), (0.170, 0.797), (0.131, 0.046)),
    "P3": ((0.680, 0.320), (0.265, 0.690), (0.150, 0.060)),
}
_ROWS = 1 << 16  # pixels converted at a time, which stay in the cache


def to_sdr(codes: np.ndarray, curve: Curve, gamut: Gamut, white: int = 65535) -> np.ndarray:
    """codes: uint16 [H,W,3], R'G'B' as decoded, 0 for no signal and `white` for all of it. Returns uint8 [H,W,3], sRGB."""
    height, width = codes.shape[:2]
    result = np.empty((height, width, 3), np.uint8)
    rows = max(1, _ROWS // width)
    for top in range(0, height, rows):
        result[top : top + rows] = _part(codes[top : top + rows], curve, gamut, white)
    return result


def _part(codes: np.ndarray, curve: Curve, gamut: Gamut, white: int) -> np.ndarray:
    import cv2

    light = np.take(_light(curve, white), codes, mode="clip")  # twice as fast as indexing
    if curve == "HLG":  # the display's light is the scene's times a power of its luminance (BT.2100, table 5)
        luminance = cv2.transform(light, _luminance(gamut))
        light *= cv2.pow(np.maximum(luminance, 1e-6), HLG_GAMMA - 1)[..., None] * (HLG_PEAK / WHITE)
    if gamut != "BT.709":
        light = cv2.transform(light, from_gamut(gamut).astype(np.float32))
    if curve != "SDR":
        most = cv2.max(cv2.max(light[..., 0], light[..., 1]), light[..., 2])
        if most.max() > KNEE:
            bright = np.maximum(most, KNEE)
            light *= ((1 - (1 - KNEE) * cv2.exp((KNEE - bright) / (1 - KNEE))) / bright)[..., None]
    return np.take(_codes(), np.clip(light * 65535 + 0.5, 0, 65535).astype(np.uint16), mode="clip")


def from_gamut(gamut: Gamut) -> np.ndarray:
    """[3,3] float64: linear RGB of `gamut` to linear RGB of BT.709; both have the white D65."""
    return np.linalg.solve(_xyz("BT.709"), _xyz(gamut))


def _xyz(gamut: str) -> np.ndarray:
    """[3,3]: linear RGB to CIE XYZ with Y = 1 for white."""

    def column(x: float, y: float) -> list[float]:
        return [x / y, 1.0, (1 - x - y) / y]

    primaries = np.array([column(*p) for p in _PRIMARIES[gamut]]).T
    return primaries * np.linalg.solve(primaries, column(*_D65))


@cache
def _luminance(gamut: Gamut) -> np.ndarray:
    return _xyz(gamut)[1:2].astype(np.float32)


@cache
def _light(curve: Curve, white: int) -> np.ndarray:
    """[65536] float32: linear light of each code. SDR, PQ: in units of diffuse white; HLG: of the scene, in [0, 1]."""
    code = np.minimum(np.arange(65536) / white, 1)
    if curve == "PQ":
        power = code ** (1 / 78.84375)
        light = (np.maximum(power - 0.8359375, 0) / (18.8515625 - 18.6875 * power)) ** (1 / 0.1593017578125) * (PQ_PEAK / WHITE)
    elif curve == "HLG":
        a, b, c = 0.17883277, 0.28466892, 0.55991073
        light = np.where(code <= 0.5, code**2 / 3, (np.exp((code - c) / a) + b) / 12)
    else:
        light = np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)
    return light.astype(np.float32)


@cache
def _codes() -> np.ndarray:
    """[65536] uint8: sRGB code of linear light in [0, 1]."""
    light = np.arange(65536) / 65535
    return np.rint(255 * np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)).astype(np.uint8)
