"""Pictures of every kind of pixels come out with right values; alpha in captures without poses is composited."""

import shutil

import numpy as np
import pytest
from e4dgs.stages.captures import checks, recognise
from e4dgs.stages.captures.assembly import transparent
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


def opaque(picture):
    return np.dstack([picture[..., :3], np.full(picture.shape[:2], 255, np.uint8)])


def rgba_photos(root, count=12, palette=False):
    root.mkdir()
    for i in range(count):
        image = Image.fromarray(opaque(np.roll(FLAT, i, 0)))
        (image.quantize() if palette else image).save(root / f"{i:02d}.png", **({"transparency": b"\xff" * 9} if palette else {}))
    return root


@pytest.mark.parametrize("palette", [False, True])
def test_an_alpha_channel_that_is_opaque_everywhere_is_none(tmp_path, palette):
    """As Blender, Unreal and Kubric write it: without silhouettes, which seeds would be carved from."""
    root = rgba_photos(tmp_path / "photos", palette=palette)
    capture = recognise(root)
    assert not capture.facts["alpha"] and capture.background is None
    (told,) = [note for note in capture.notes if "alpha" in note]
    assert told.startswith("12 pictures have an alpha channel that is opaque everywhere (judged by 8 of them")
    frames = FrameSet(run_frames(root, tmp_path / "out").artifact, root)
    assert frames.image(3).shape[2] == 3 and frames.image(3).flags.c_contiguous
    if not palette:
        np.testing.assert_array_equal(frames.image(3), np.roll(FLAT, 3, 0)[..., :3])


@pytest.mark.parametrize("which", [0, 11])
def test_one_transparent_pixel_makes_alpha_count(tmp_path, which):
    root = rgba_photos(tmp_path / "photos")
    picture = opaque(FLAT)
    picture[0, 0, 3] = 254
    Image.fromarray(picture).save(root / f"{which:02d}.png")
    assert recognise(root).facts["alpha"]


def test_as_few_pictures_as_are_needed_are_decoded_for_alpha(tmp_path, monkeypatch):
    root, looked = rgba_photos(tmp_path / "photos", 20), []
    monkeypatch.setattr(transparent, "_shows_through", lambda path: looked.append(path.name) or len(looked) == 2)
    assert recognise(root).facts["alpha"] and looked == ["00.png", "03.png"]
    looked[:] = [None, None]
    recognise(root)
    assert looked[2:] == [f"{i:02d}.png" for i in (0, 3, 5, 8, 11, 14, 16, 19)]


def test_transparent_pixels_that_the_sample_missed_are_told(tmp_path):
    root = rgba_photos(tmp_path / "photos")
    Image.fromarray(FLAT).save(root / "01.png")
    run = run_frames(root, tmp_path / "out")
    assert any("transparent pixels show the colours stored in them" in line and "(1 picture)" in line for line in run.lines)
    np.testing.assert_array_equal(FrameSet(run.artifact, root).image(1), FLAT[..., :3])


@pytest.mark.parametrize("background", [None, "black"])
@pytest.mark.parametrize("layout", ["images", "colmap", "nerfstudio", "dnerf"])
def test_what_transparent_pixels_are_taken_for_is_told(request, tmp_path, layout, background):
    """Photos often have alpha where something is to be ignored; in D-NeRF's layout it is a silhouette by custom."""
    root = shutil.copytree(request.getfixturevalue(f"{layout}_capture").root, tmp_path / "capture")
    if layout != "dnerf":
        for file in root.rglob("*.png"):
            picture = np.array(Image.open(file).convert("RGBA"))
            picture[:3, :3, 3] = 0
            Image.fromarray(picture).save(file)
    capture = recognise(root, background=background)
    told = [note for note in capture.notes if "transparent pixels" in note]
    assert capture.facts["alpha"] and len(told) == (layout != "dnerf")
    for note in told:
        assert f"are taken for empty space, shown on {background or 'white'}" in note and "masks/ beside images/" in note
