"""Watermarks from the stage that finds them to the pixels that count."""

import shutil

import cv2
import numpy as np
import pytest
import torch
from e4dgs.stages.shared.dataset import load_views
from e4dgs.stages.shared.frameset import FrameSet
from factory import Options, make, write_images, write_nerfstudio
from PIL import Image
from run_stage import run_frames
from write_artifact import write_artifact

CORNER = (slice(95, 120), slice(100, 160))  # rows, columns; the letters lie within it


def written_over(root, names):
    for name in names:
        picture = np.array(Image.open(root / name).convert("RGB"))
        cv2.putText(picture, "Logo", (104, 112), cv2.FONT_HERSHEY_SIMPLEX, 0.6, (235, 235, 235), 2, cv2.LINE_AA)
        Image.fromarray(picture).save(root / name, quality=95)


@pytest.fixture(scope="module")
def film(tmp_path_factory):
    """14 pictures of one camera, with a logo."""
    options = Options(backdrop="room", rig="path", times=14, width=160, height=120, fov_degrees=60.0, samples=1)
    capture = write_images(make(options), tmp_path_factory.mktemp("film") / "photos")
    written_over(capture.root, capture.files)
    return capture.root


def test_it_is_found_said_and_left_out(film, tmp_path):
    ran = run_frames(film, tmp_path)
    assert any("stands still while the camera moves" in line and "frames.watermark=false" in line for line in ran.lines)
    frames = FrameSet(ran.artifact, film)
    kept = frames.kept(3)
    assert frames.masked and kept.shape == (120, 160) and kept.dtype == bool
    assert 0.005 < 1 - kept.mean() < 0.1
    outside = np.ones_like(kept)
    outside[CORNER] = False
    assert kept[outside].all()


def test_it_can_be_used_all_the_same(film, tmp_path):
    ran = run_frames(film, tmp_path, watermark=False)
    frames = FrameSet(ran.artifact, film)
    assert "watermark" not in ran.artifact and not frames.masked and frames.kept(3) is None


def test_it_is_bent_as_the_pictures_are_and_joins_their_masks(film, tmp_path):
    root = shutil.copytree(film, tmp_path / "film")
    (root / "masks").mkdir()
    own = np.full((120, 160), 255, np.uint8)
    own[10:40, :30] = 0
    names = sorted(file.name for file in root.glob("*.*"))
    Image.fromarray(own).save(root / "masks" / f"{names[2]}.png")
    artifact = run_frames(root, tmp_path).artifact
    lens = np.tile([-0.2, 0.05, 0.0, 0.0], (14, 1))
    K = np.tile([[140.0, 0, 80], [0, 140, 60], [0, 0, 1]], (14, 1, 1))
    arrays = {name: artifact.read(name) for name in artifact.names()}
    arrays |= {"K": K, "cam_from_world": np.tile(np.eye(4), (14, 1, 1)), "distortion": lens}
    posed = write_artifact(tmp_path / "posed", arrays, **artifact.attrs)
    frames = FrameSet(posed, root)
    assert frames.bent(0) and frames.watermark is not None
    bent = cv2.remap(255 - frames.watermark, *frames.undistortion(0), interpolation=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    assert not np.array_equal(bent >= 254, frames.watermark == 0)
    np.testing.assert_array_equal(frames.kept(0), bent >= 254)
    both = frames.kept(2)
    assert not both[15:35, 5:25].any() and not both[bent < 128].any() and both.mean() > 0.85
    views = load_views(frames, None)
    assert not views.kept(0)[torch.from_numpy(bent < 128)].any() and views.kept(0).float().mean() > 0.9


def test_captures_with_poses_and_rigs_are_not_searched(film, n3v_capture, tmp_path):
    options = Options(backdrop="room", rig="path", times=14, width=160, height=120, fov_degrees=60.0, samples=1)
    posed = write_nerfstudio(make(options), tmp_path / "posed")
    written_over(posed.root, posed.files)
    for name, capture in (("poses", posed), ("rig", n3v_capture)):
        assert "watermark" not in run_frames(capture.root, tmp_path / name).artifact


def test_black_bars_are_said_and_left_out(film, tmp_path):
    root = shutil.copytree(film, tmp_path / "film")
    for file in root.glob("*.*"):
        picture = np.array(Image.open(file).convert("RGB"))
        picture[:18] = picture[-18:] = 0
        Image.fromarray(picture).save(file, quality=95)
    ran = run_frames(root, tmp_path)
    (line,) = [line for line in ran.lines if "black bars" in line]
    assert "33% of each picture" in line and "crop=iw*1.0000:ih*0.6667:iw*0.0000:ih*0.1667" in line
    kept = FrameSet(ran.artifact, root).kept(3)
    assert not kept[:18].any() and not kept[-18:].any() and kept[22:90, :90].all()
    assert "watermark" not in run_frames(root, tmp_path / "off", watermark=False).artifact
