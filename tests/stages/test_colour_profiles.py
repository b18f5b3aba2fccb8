"""Photos with a colour profile other than sRGB come out as sRGB, and a line says so."""

import struct
import zlib
from fractions import Fraction

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


def coded(path, primaries, transfer, full=1, picture=COLOURS, **options):
    """A PNG with a cICP chunk, as FFmpeg writes one for frames of HDR video."""
    Image.fromarray(picture).save(path, **options)
    data, chunk = path.read_bytes(), b"cICP" + bytes([primaries, transfer, 0, full])
    path.write_bytes(data[:33] + struct.pack(">I", 4) + chunk + struct.pack(">I", zlib.crc32(chunk)) + data[33:])
    said = []
    return read_picture(path.parent, path.name, say=said.append), said


@pytest.mark.parametrize(
    ("primaries", "transfer", "curve", "gamut", "line"),
    [
        (9, 16, "PQ", "BT.2020", "HDR (PQ, BT.2020) is converted to SDR"),
        (9, 18, "HLG", "BT.2020", "HDR (HLG, shown at 1000 cd/m2, BT.2020) is converted to SDR"),
        (2, 18, "HLG", "BT.2020", "HDR (HLG, shown at 1000 cd/m2, BT.2020) is converted to SDR"),
        (12, 16, "PQ", "P3", "HDR (PQ, P3) is converted to SDR"),
        (12, 13, "SDR", "P3", "wide gamut (P3) is converted"),
        (9, 14, "SDR", "BT.2020", "wide gamut (BT.2020) is converted"),
    ],
)
@pytest.mark.parametrize("profile", [None, P3])
def test_frames_of_hdr_video_become_srgb(tmp_path, primaries, transfer, curve, gamut, line, profile):
    """As the video itself does, in spite of a profile, which cICP outranks (PNG, third edition, 4.3)."""
    got, said = coded(tmp_path / "hdr.png", primaries, transfer, icc_profile=profile)
    np.testing.assert_array_equal(got, to_sdr(COLOURS.astype(np.uint16), curve, gamut, white=255))
    assert len(said) == 1 and line in said[0]


def test_alpha_and_grey_of_hdr_frames(tmp_path):
    alpha = np.dstack([COLOURS, COLOURS[..., :1]])
    got, _ = coded(tmp_path / "cut.png", 9, 16, picture=alpha)
    np.testing.assert_array_equal(got[..., 3], alpha[..., 3])
    np.testing.assert_array_equal(got[..., :3], coded(tmp_path / "whole.png", 9, 16)[0])
    grey = COLOURS[..., 0].astype(np.uint16) * 257
    want = to_sdr(np.repeat(grey[..., None], 3, axis=2), "HLG", "BT.2020")
    np.testing.assert_array_equal(coded(tmp_path / "deep.png", 9, 18, picture=grey)[0], want)


def test_plain_coding_points_change_nothing(tmp_path):
    for primaries, transfer in ((1, 13), (1, 1), (6, 6)):
        got, said = coded(tmp_path / "plain.png", primaries, transfer, icc_profile=P3)
        np.testing.assert_array_equal(got, COLOURS)
        assert said == []
    got, said = coded(tmp_path / "open.png", 2, 2, icc_profile=P3)  # leaves it to the profile
    assert np.abs(got.astype(int) - COLOURS).max() > 20 and "colours are converted from" in said[0]


@pytest.mark.parametrize(
    ("primaries", "transfer", "full", "line"),
    [(1, 8, 1, "transfer curve (linear) is not"), (10, 13, 1, "primaries (CIE XYZ) are not"), (1, 13, 0, "limited range is not")],
)
def test_coding_points_that_are_not_converted_are_told(tmp_path, primaries, transfer, full, line):
    got, said = coded(tmp_path / "odd.png", primaries, transfer, full)
    np.testing.assert_array_equal(got, COLOURS)
    assert len(said) == 1 and f"the {line} converted" in said[0]


def test_frames_that_ffmpeg_writes_say_how_they_are_coded(tmp_path):
    """The chunk of a real encoder, and a line of the run."""
    import av

    photos = tmp_path / "photos"
    photos.mkdir()
    for i in range(4):
        encoder = av.CodecContext.create("png", "w")
        encoder.width, encoder.height, encoder.pix_fmt, encoder.time_base = 16, 12, "rgb24", Fraction(1, 30)
        frame = av.VideoFrame.from_ndarray(np.roll(COLOURS, i, 0), format="rgb24")
        frame.color_trc, frame.color_primaries, frame.pts = 18, 9, 0
        (photos / f"{i}.png").write_bytes(b"".join(bytes(packet) for packet in [*encoder.encode(frame), *encoder.encode()]))
    text = "\n".join(run_frames(photos, tmp_path / "out").lines)
    assert "HDR (HLG, shown at 1000 cd/m2, BT.2020) is converted to SDR (sRGB, BT.709)" in text and "(4 pictures)" in text
