"""TIFF photos whose orientation tag asks for a turn: as stored where poses apply to them, upright where nothing else says how they lie.

Pillow turns a TIFF while it loads it, and no other kind of file."""

import struct
import zlib

import numpy as np
import pytest
from e4dgs.stages.captures import checks, recognise
from e4dgs.stages.shared.frameset import FrameSet
from e4dgs.vision.images.pictures import read_mask, read_picture
from factory import Options, make, write_colmap, write_nerfstudio
from PIL import Image
from PIL.PngImagePlugin import PngImageFile
from run_stage import run_frames

TURNS = {
    1: lambda a: a,
    2: np.fliplr,
    3: lambda a: np.rot90(a, 2),
    4: np.flipud,
    5: lambda a: a.swapaxes(0, 1),
    6: lambda a: np.rot90(a, -1),
    7: lambda a: np.rot90(a, 2).swapaxes(0, 1),
    8: np.rot90,
}
KINDS = {
    "plain": {},
    "lzw": {"compression": "tiff_lzw"},
    "deflate": {"compression": "tiff_adobe_deflate"},
    "jpeg": {"compression": "jpeg", "quality": 100, "subsampling": 0},
}


def corner(size=(16, 12), value=200):
    """A picture, size px, whose top left corner is bright: no two turns of it are alike."""
    picture = np.zeros((size[1], size[0], 3), np.uint8)
    picture[: size[1] // 3, : size[0] // 2] = value
    return picture


def save(path, picture, orientation, **options):
    tags = Image.Exif()
    tags[0x0112] = orientation
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(picture).save(path, exif=tags, **options)


@pytest.mark.parametrize("turn", range(1, 9))
@pytest.mark.parametrize("kind", KINDS)
def test_a_tiff_is_what_is_stored_and_upright_it_is_turned_once(tmp_path, turn, kind):
    picture = corner()
    save(tmp_path / "a.tif", picture, turn, **KINDS[kind])
    assert checks.orientation(tmp_path, "a.tif") == turn
    assert checks.image_header(tmp_path, "a.tif") == (16, 12, False)
    shown = TURNS[turn](picture)
    assert checks.upright_headers(tmp_path, ["a.tif"]) == ([shown.shape[1::-1]], False, turn != 1)
    tolerance = 60 if kind == "jpeg" else 0
    np.testing.assert_allclose(read_picture(tmp_path, "a.tif"), picture, atol=tolerance)
    np.testing.assert_allclose(read_picture(tmp_path, "a.tif", upright=True), shown, atol=tolerance)


def chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


@pytest.mark.parametrize("place", ["in front", "behind", "as text", "as text behind", "none"])
def test_the_orientation_of_a_png_is_found_wherever_it_stands(tmp_path, place, monkeypatch):
    """Pillow decodes the pixels to look behind them; plain pictures are spared that, since `plan` looks at headers alone."""
    Image.fromarray(corner()).save(tmp_path / "a.png")
    data = (tmp_path / "a.png").read_bytes()
    tags = Image.Exif()
    tags[0x0112] = 6
    said = b'<x tiff:Orientation="6"/>'
    added = chunk(b"iTXt", b"XML:com.adobe.xmp\0\0\0\0\0" + said) if "text" in place else chunk(b"eXIf", tags.tobytes()[6:])
    at = data.index(b"IEND" if "behind" in place else b"IDAT") - 4
    (tmp_path / "a.png").write_bytes(data if place == "none" else data[:at] + added + data[at:])
    loads = []
    monkeypatch.setattr(PngImageFile, "load_prepare", lambda self, own=PngImageFile.load_prepare: (loads.append(1), own(self))[1])
    assert checks.upright_headers(tmp_path, ["a.png"])[0] == [(16, 12) if place == "none" else (12, 16)]
    assert bool(loads) == ("behind" in place)
    np.testing.assert_array_equal(read_picture(tmp_path, "a.png", upright=True), corner() if place == "none" else np.rot90(corner(), -1))


@pytest.mark.parametrize("turn", range(2, 9))
@pytest.mark.parametrize("deep", [np.uint8, np.uint16], ids=["8 bits", "16 bits"])
def test_grey_tiffs_and_masks_too(tmp_path, turn, deep):
    scale = 257 if deep is np.uint16 else 1
    picture = corner(value=255)[..., 0].astype(deep) * scale
    save(tmp_path / "a.tif", picture, turn)
    np.testing.assert_array_equal(read_picture(tmp_path, "a.tif")[..., 0], picture // scale)
    np.testing.assert_array_equal(read_picture(tmp_path, "a.tif", upright=True)[..., 1], TURNS[turn](picture // scale))
    np.testing.assert_array_equal(read_mask(tmp_path, "a.tif"), picture // scale)
    np.testing.assert_array_equal(read_mask(tmp_path, "a.tif", turn), TURNS[turn](picture // scale))


def test_photos_are_upright_and_so_are_their_masks(tmp_path):
    root = tmp_path / "photos"
    for i in range(3):
        save(root / f"{i}.tif", corner(), 6)
        save(root / f"masks/{i}.tif", 255 - corner(value=255), 6)
    frames = FrameSet(run_frames(root, tmp_path / "out").artifact, root)
    assert (frames.width, frames.height) == (12, 16) and frames.keep_turns == [6, 6, 6]
    for i in range(3):
        np.testing.assert_array_equal(frames.image(i), np.rot90(corner(), -1))
        np.testing.assert_array_equal(frames.kept(i), frames.image(i)[..., 0] == 0)


@pytest.mark.parametrize("turn", [3, 6])
@pytest.mark.parametrize("write", [write_colmap, write_nerfstudio])
def test_poses_belong_to_the_pixels_as_stored(tmp_path, write, turn):
    made = write(make(Options(times=3, cameras=1, width=20, height=16)), tmp_path / "capture")
    before = {file.rsplit(".", 1)[0]: read_picture(made.root, file) for file in made.files}
    for file, picture in zip(made.files, before.values(), strict=True):
        (made.root / file).unlink()
        save(made.root / f"{file.rsplit('.', 1)[0]}.tif", picture, turn)
    for listing in (*made.root.glob("sparse/0/images.txt"), *made.root.glob("transforms.json")):
        listing.write_text(listing.read_text().replace(".png", ".tif").replace(".jpg", ".tif"))
    capture = recognise(made.root)
    assert (capture.facts["width"], capture.facts["height"]) == (20, 16) and not capture.facts.get("upright")
    frames = FrameSet(run_frames(made.root, tmp_path / "out").artifact, made.root)
    for i in range(len(frames)):
        np.testing.assert_array_equal(frames.original(i), before[frames.files[i].rsplit(".", 1)[0]])
