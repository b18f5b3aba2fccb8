"""Photos with a colour profile other than sRGB come out as sRGB, and a line says so."""

import struct

import numpy as np
import pytest
from e4dgs.vision.images.pictures import read_mask, read_picture
from e4dgs.vision.images.wide_colour import to_sdr
from PIL import Image, ImageCms
from run_stage import run_frames

PRIMARIES = {  # of Display P3, XYZ adapted to D50, as phones write them
    b"rXYZ": (0.5151, 0.2412, -0.0011),
    b"gXYZ": (0.2920, 0.6922, 0.0419),
    b"bXYZ": (0.1571, 0.0666, 0.7841),
}
COLOURS = np.random.default_rng(0).integers(0, 256, (12, 16, 3)).astype(np.uint8)


def profile(primaries: dict[bytes, tuple[float, float, float]]) -> bytes:
    """The profile of sRGB with other primaries (ICC.1:2010, table of tags)."""
    data = bytearray(ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes())
    for i in range(struct.unpack(">I", data[128:132])[0]):
        tag, offset, _ = struct.unpack(">4sII", data[132 + 12 * i : 144 + 12 * i])
        if tag in primaries:
            data[offset + 8 : offset + 20] = struct.pack(">3i", *(round(65536 * value) for value in primaries[tag]))
    return bytes(data)


P3, SRGB = profile(PRIMARIES), profile({})


@pytest.mark.parametrize("suffix", ["png", "tif", "webp"])
def test_photos_in_p3_become_srgb(tmp_path, suffix):
    """As video in P3 does. Profiles hold rounded numbers, and each side clips colours beyond sRGB in its own way, so these are left out."""
    lossless = {"lossless": True} if suffix == "webp" else {}
    Image.fromarray(COLOURS).save(tmp_path / f"wide.{suffix}", icc_profile=P3, **lossless)
    got = read_picture(tmp_path, f"wide.{suffix}").astype(int)
    want = to_sdr(COLOURS.astype(np.uint16) * 257, "SDR", "P3").astype(int)
    inside = ((want > 0) & (want < 255)).all(2)
    assert inside.mean() > 0.5
    assert np.abs(got - want)[inside].max() <= 3 and np.abs(got - COLOURS).max() > 20


@pytest.mark.parametrize("profile", [SRGB, None, b"not a profile at all", P3[:200]])
def test_other_photos_stay_as_they_are(tmp_path, profile):
    Image.fromarray(COLOURS).save(tmp_path / "plain.png", icc_profile=profile)
    np.testing.assert_array_equal(read_picture(tmp_path, "plain.png"), COLOURS)


def test_alpha_and_masks_are_not_converted(tmp_path):
    alpha = np.dstack([COLOURS, COLOURS[..., :1]])
    Image.fromarray(alpha).save(tmp_path / "cut.png", icc_profile=P3)
    picture = read_picture(tmp_path, "cut.png")
    np.testing.assert_array_equal(picture[..., 3], alpha[..., 3])
    Image.fromarray(COLOURS).save(tmp_path / "whole.png", icc_profile=P3)
    np.testing.assert_array_equal(picture[..., :3], read_picture(tmp_path, "whole.png"))
    Image.fromarray(COLOURS[..., 0]).save(tmp_path / "mask.png", icc_profile=P3)
    np.testing.assert_array_equal(read_mask(tmp_path, "mask.png"), COLOURS[..., 0])


def test_a_photo_that_is_turned_is_converted_too(tmp_path):
    """As a phone writes it that is held upright."""
    exif = Image.Exif()
    exif[0x0112] = 6
    Image.fromarray(COLOURS).save(tmp_path / "flat.jpg", icc_profile=P3, quality=100, subsampling=0)
    Image.fromarray(COLOURS).save(tmp_path / "turned.jpg", icc_profile=P3, quality=100, subsampling=0, exif=exif)
    flat = read_picture(tmp_path, "flat.jpg")
    assert np.abs(flat.astype(int) - COLOURS).max() > 20
    np.testing.assert_array_equal(read_picture(tmp_path, "turned.jpg", upright=True), np.rot90(flat, -1))


def test_lines_say_what_was_done(tmp_path):
    photos = tmp_path / "photos"
    photos.mkdir()
    for i, icc in enumerate([P3, P3, SRGB, None, b"not a profile at all"]):
        Image.fromarray(np.roll(COLOURS, i, 0)).save(photos / f"{i}.png", icc_profile=icc)
    text = "\n".join(run_frames(photos, tmp_path / "out").lines)
    assert "colours are converted from sRGB built-in to sRGB (2 pictures)" in text and text.count("colours are converted") == 1
    assert "colours are taken as sRGB, in spite of a profile that cannot be read" in text and "(1 picture)" in text
