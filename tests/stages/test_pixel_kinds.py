"""Pictures of every kind of pixels come out with right values; alpha in captures without poses is composited."""

import numpy as np
import pytest
from e4dgs.stages.captures import checks, recognise
from e4dgs.stages.shared.frameset import FrameSet
from e4dgs.vision.images.pictures import composite, read_picture
from PIL import Image
from run_stage import run_frames

RNG = np.random.default_rng(3)
DEEP = RNG.integers(0, 65536, (12, 16, 4)).astype(np.uint16)
FLAT = (DEEP >> 8).astype(np.uint8)


def read(root, name):
    width, height, alpha = checks.image_header(root, name)
    picture = read_picture(root, name)
    assert (height, width) == picture.shape[:2]
    return picture, alpha


@pytest.mark.parametrize("suffix", ["png", "tif"])
@pytest.mark.parametrize("channels", [3, 4])
def test_colours_of_sixteen_bits(tmp_path, suffix, channels):
    """To within one level of 255: the high byte, or the nearest."""
    import cv2

    order = [2, 1, 0, 3][:channels]
    cv2.imwrite(str(tmp_path / f"deep.{suffix}"), DEEP[..., order])
    assert cv2.imread(str(tmp_path / f"deep.{suffix}"), cv2.IMREAD_UNCHANGED).dtype == np.uint16
    picture, alpha = read(tmp_path, f"deep.{suffix}")
    assert picture.shape == (12, 16, channels) and alpha == (channels == 4)
    assert np.abs(picture - DEEP[..., :channels] / 257.0).max() <= 1


@pytest.mark.parametrize("suffix", ["png", "tif"])
@pytest.mark.parametrize("big_endian", [False, True])
def test_grey_of_sixteen_bits(tmp_path, suffix, big_endian):
    image = Image.fromarray(DEEP[..., 0])
    if big_endian:
        image = Image.frombytes("I;16B", image.size, DEEP[..., 0].byteswap().tobytes())
    image.save(tmp_path / f"deep.{suffix}")
    picture, alpha = read(tmp_path, f"deep.{suffix}")
    assert not alpha and np.abs(picture - DEEP[..., :1] / 257.0).max() <= 0.5


def test_grey_of_eight_bits_with_and_without_alpha(tmp_path):
    Image.fromarray(FLAT[..., 0]).save(tmp_path / "grey.png")
    Image.merge("LA", [Image.fromarray(FLAT[..., c]) for c in (0, 1)]).save(tmp_path / "veiled.png")
    picture, alpha = read(tmp_path, "grey.png")
    assert not alpha
    np.testing.assert_array_equal(picture, FLAT[..., :1].repeat(3, 2))
    picture, alpha = read(tmp_path, "veiled.png")
    assert alpha
    np.testing.assert_array_equal(picture, np.concatenate([FLAT[..., :1].repeat(3, 2), FLAT[..., 1:2]], 2))


@pytest.mark.parametrize("suffix", ["tif", "jpg"])
def test_print_colours(tmp_path, suffix):
    """Ink over white: what is neither taken by its own ink nor by black."""
    ink = np.zeros((16, 48, 4), np.uint8)
    ink[:, :16], ink[:, 16:32], ink[:, 32:] = (255, 0, 0, 0), (0, 128, 0, 64), (0, 0, 0, 255)
    Image.fromarray(ink, "CMYK").save(tmp_path / f"print.{suffix}")
    picture, alpha = read(tmp_path, f"print.{suffix}")
    expected = (255 - ink[..., :3].astype(float)) * (255 - ink[..., 3:]) / 255
    assert not alpha and np.abs(picture - expected)[:, 4::16].max() <= (1 if suffix == "tif" else 6)


@pytest.mark.parametrize("background", ["white", "black"])
def test_alpha_of_photos_without_poses_is_composited(tmp_path, background):
    (tmp_path / "photos").mkdir()
    for i in range(3):
        Image.fromarray(np.roll(FLAT, i, 0)).save(tmp_path / f"photos/{i}.png")
    Image.fromarray(FLAT[..., :3]).save(tmp_path / "photos/3.png")
    capture = recognise(tmp_path / "photos")
    assert capture.facts["alpha"] and capture.background == "white" and not capture.facts["poses"]
    frames = FrameSet(run_frames(tmp_path / "photos", tmp_path / "out", background=background).artifact, tmp_path / "photos")
    back = 255.0 if background == "white" else 0.0
    for i in range(3):
        pixels = np.roll(FLAT, i, 0).astype(float)
        expected = pixels[..., :3] * pixels[..., 3:] / 255 + back * (1 - pixels[..., 3:] / 255)
        assert np.abs(frames.composited(i) - expected).max() <= 0.51
        np.testing.assert_array_equal(composite(frames.original(i), background), frames.composited(i))
    np.testing.assert_array_equal(frames.composited(3), FLAT[..., :3])
