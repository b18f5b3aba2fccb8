"""Folders of pictures: straight alpha in PNG, premultiplied linear light and depth in EXR, all there or not there."""

import os

import numpy as np
import OpenEXR
import pytest
from e4dgs.pipeline import StageError
from e4dgs.vision.images.picture_folder import NOTHING, PictureFolder, linear
from PIL import Image

STRAIGHT = np.array([0.8, 0.4, 0.2])


def written(folder, depth=True, alpha=True):
    """A pixel that is opaque, one of a quarter, and one with nothing, as a rasterizer gives them over black."""
    cover = np.array([[1.0, 0.25, 0.0]], np.float32)
    with PictureFolder(folder, depth, alpha) as pictures:
        pictures.add((STRAIGHT * cover[..., None]).astype(np.float32), cover, np.array([[2.0, 3.0, 0.0]], np.float32))
    return folder


def test_the_alpha_of_a_png_is_straight(tmp_path):
    shown = np.asarray(Image.open(written(tmp_path / "out") / "0000.png"))
    assert shown.tolist() == [[[204, 102, 51, 255], [204, 102, 51, 64], [0, 0, 0, 0]]]
    assert np.asarray(Image.open(tmp_path / "out" / "masks" / "0000.png")).tolist() == [[255, 64, 0]]


def test_an_exr_is_premultiplied_linear_light_with_depth_that_a_merge_can_use(tmp_path):
    file = OpenEXR.File(str(written(tmp_path / "out") / "0000.exr"))
    colour, depth = (file.channels()[name].pixels for name in ("RGBA", "Z"))
    expected = np.append(linear(STRAIGHT), 1.0) * np.array([[1.0], [0.25], [0.0]])
    np.testing.assert_allclose(colour[0], expected, rtol=2e-3)
    np.testing.assert_array_equal(depth, np.array([[2.0, 3.0, NOTHING]], np.float32))
    header = file.header()
    assert header["depthOfNothing"] == NOTHING and header["depthKind"] == "planar"
    assert "premultiplied" in header["comments"] and "optical axis" in header["comments"]


def test_depth_alone_has_the_same_nothing(tmp_path):
    out = written(tmp_path / "out", alpha=False)
    assert sorted(file.name for file in out.iterdir()) == ["0000.exr", "0000.png"]
    channels = OpenEXR.File(str(out / "0000.exr")).channels()
    assert list(channels) == ["Z"] and channels["Z"].pixels[0].tolist() == [2.0, 3.0, np.float32(NOTHING)]


def test_linear_light_is_that_of_srgb():
    np.testing.assert_allclose(linear(np.array([0.0, 0.04045, 0.5, 1.0])), [0.0, 0.0031308, 0.2140411, 1.0], rtol=1e-5)


def test_a_folder_that_breaks_off_leaves_nothing(tmp_path):
    with pytest.raises(RuntimeError), PictureFolder(tmp_path / "out", alpha=True) as pictures:
        pictures.add(np.zeros((2, 2, 3), np.float32), np.zeros((2, 2), np.float32), np.zeros((2, 2), np.float32))
        raise RuntimeError
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("kind", ["link", "dangling link", "current folder", "mount point", "killed"])
def test_a_folder_that_no_other_can_replace_gets_the_pictures(tmp_path, monkeypatch, kind):
    real, out = tmp_path / "real", tmp_path / "out"
    if kind != "dangling link":
        real.mkdir()
    if kind == "current folder":
        monkeypatch.chdir(real)
        out = type(out)(".")
    elif kind in ("mount point", "killed"):  # of a mount, neither the folder nor its parent may be changed
        monkeypatch.setattr("pathlib.Path.rmdir", lambda self: os.rmdir(self) if self.parent == real else pytest.fail(f"rmdir {self}"))
        out = real
        if kind == "killed":
            (real / ".render-left").mkdir()
    else:
        out.symlink_to(real)
    before = real.stat().st_ino if real.exists() else None
    written(out)
    assert sorted(file.name for file in real.iterdir() if file.name != ".render-left") == ["0000.exr", "0000.png", "masks"]
    assert before in (None, real.stat().st_ino) and out.is_symlink() == kind.endswith("link")
    assert {one.name for one in tmp_path.iterdir()} <= {"real", "out"}


@pytest.mark.parametrize("exists", [True, False])
def test_pictures_that_cannot_go_to_their_folder_are_kept_and_named(tmp_path, exists):
    out, blank = tmp_path / "out", np.zeros((2, 2), np.float32)
    if exists:
        out.mkdir()
    with pytest.raises(StageError, match="cannot go there") as raised, PictureFolder(out) as pictures:
        pictures.add(np.zeros((2, 2, 3), np.float32), blank, blank)
        out.mkdir(exist_ok=True)
        (out / "0000.png").write_text("of another render")
    (part,) = [one for one in (out if exists else tmp_path).iterdir() if one.name.startswith(".render-")]
    assert f"they are in {part}, move them" in str(raised.value) and [one.name for one in part.iterdir()] == ["0000.png"]
    assert (out / "0000.png").read_text() == "of another render"
