"""Pictures of several sizes in one capture come to one size, and their cameras stay true."""

import json
import shutil

import numpy as np
import pytest
from e4dgs.pipeline import CaptureError
from e4dgs.stages.captures import recognise
from e4dgs.stages.captures.assembly.common_size import common_size, crop, told
from e4dgs.stages.shared.frameset import FrameSet
from factory import Camera, Options, make, render, write_colmap, write_dnerf, write_images, write_n3v, write_nerfstudio, write_panoptic
from factory.writers import flatten
from PIL import Image
from run_stage import run_frames

SIZES = ((80, 64), (80, 64), (120, 96), (64, 80))  # most, larger of the same shape, upright
PATH = Options(backdrop="room", rig="path", times=8, sizes=SIZES, samples=3, fov_degrees=60.0)
RIG = Options(backdrop="room", rig="arc", cameras=4, times=3, sizes=((80, 64), (120, 90)), samples=3, fov_degrees=60.0)


def assert_true_to_their_cameras(frames, capture, views, least):
    """Each picture equals a render with the K that the frameset gives, and not one a pixel away."""
    assert (frames.width, frames.height) == (80, 64)
    for i, view in enumerate(views):
        assert frames.image(i).shape[:2] == (64, 80)
        camera = Camera(frames.K[i], view.camera.cam_from_world, 80, 64)
        truth = flatten(render(capture.synthetic.scene, camera, view.time, 4)).astype(float)
        error, moved = (
            np.square(p[2:-2, 2:-2] - truth[2:-2, 2:-2]).mean()
            for p in (frames.composited(i).astype(float), np.roll(frames.composited(i), 1, 1))
        )
        assert 10 * np.log10(255**2 / error) > least and error < moved / 3, i


@pytest.mark.parametrize(("write", "options"), [(write_nerfstudio, PATH), (write_colmap, PATH), (write_panoptic, RIG), (write_n3v, RIG)])
def test_cameras_follow_their_pictures(tmp_path, write, options):
    if write is write_panoptic:
        options = Options(**{**options.__dict__, "sizes": ((80, 64), (120, 96)), "width": 80, "height": 64})
    synthetic = make(options)
    if write is write_panoptic:  # one w and h for the whole rig, so K is that of the pictures of this size
        capture = write(synthetic, tmp_path / "capture")
        for file in ("train_meta.json", "test_meta.json"):
            data = json.loads((capture.root / file).read_text())
            for row in data["k"]:
                for K in row:
                    scale = 80 / (2 * K[0][2])
                    K[0], K[1] = [v * scale for v in K[0]], [v * scale for v in K[1]]
            (capture.root / file).write_text(json.dumps(data))
    else:
        capture = write(synthetic, tmp_path / "capture")
    ran = run_frames(capture.root, tmp_path, holdout=0)
    frames = FrameSet(ran.artifact, capture.root)
    if write is write_n3v:
        views = [next(v for v in capture.views if f"cam{v.camera_index:02d}.mp4#{v.time_index}" == name) for name in frames.names]
    else:
        views = [capture.views[capture.files.index(name)] for name in frames.names]
    assert_true_to_their_cameras(frames, capture, views, 20 if write is write_n3v else 22)
    assert sum("pictures are not 80x64 px" in line for line in ran.lines) == 1


def test_d_nerf_keeps_its_alpha(tmp_path):
    capture = write_dnerf(make(Options(sizes=((64, 64), (64, 64), (96, 96)))), tmp_path / "capture")
    ran = run_frames(capture.root, tmp_path)
    frames = FrameSet(ran.artifact, capture.root)
    assert frames.image(2).shape == (64, 64, 4) and ran.artifact.read("crop")[2].tolist() == [0, 0, 96, 96]
    camera = Camera(frames.K[2], capture.views[2].camera.cam_from_world, 64, 64)
    truth = flatten(render(capture.synthetic.scene, camera, capture.views[2].time, 4)).astype(float)
    error, moved = (np.square(p - truth).mean() for p in (frames.composited(2), np.roll(frames.composited(2), 1, 1)))
    assert error < moved / 5 and error < 30


def test_the_commonest_size_and_of_equals_the_smaller():
    assert common_size([(80, 64), (120, 96), (80, 64)]) == (80, 64)
    assert common_size([(120, 96), (80, 64)]) == (80, 64)
    assert common_size([(320, 180), (640, 360), (180, 320)]) == (320, 180), (
        "two of three are wide, though the upright one is first by width"
    )
    assert common_size([(180, 320)] * 2 + [(320, 180)] * 2 + [(641, 361)]) == (320, 180)
    assert common_size([(160, 90)] * 2 + [(100, 100)] * 2 + [(90, 160)] * 2) == (100, 100), "of equals that which crops least"
    assert common_size([(640, 360)] * 3 + [(320, 180)]) == (640, 360)
    assert crop((120, 96), (80, 64)) == (0, 0, 120, 96)
    assert crop((64, 80), (80, 64)) == (0, 14, 64, 51)
    assert crop((81, 64), (80, 64)) == (0, 0, 80, 64)
    assert crop((1, 500), (80, 64)) == (0, 249, 1, 1)


def test_what_is_lost_is_said(tmp_path):
    capture = write_images(make(PATH), tmp_path / "photos")
    (note,) = recognise(capture.root).notes
    assert note == (
        "4 of 8 pictures are not 80x64 px, the shape of most (first 002.png, 120x96): they are scaled to that size, "
        "with up to 36% of a picture cropped at its sides, and enlarged up to 1.2 times"
    )


def test_only_what_most_are_is_called_so():
    names = [str(k) for k in range(5)]
    assert "3 of 5 pictures are not 8x8 px (first 2" in told([(8, 8)] * 2 + [(8, 4), (4, 8), (3, 9)], names, (8, 8))
    assert "2 of 5 pictures are not 8x8 px as most are (first 3" in told([(8, 8)] * 3 + [(8, 4), (4, 8)], names, (8, 8))
    assert "2 of 4 pictures are not 8x8 px (first 2" in told([(8, 8)] * 2 + [(8, 4), (4, 8)], names[:4], (8, 8))


def test_pictures_of_two_sizes_are_no_pair(tmp_path):
    capture = write_images(make(PATH), tmp_path / "photos")
    np.testing.assert_array_equal(recognise(capture.root, holdout=0).next, [1, -1, -1, -1, 5, -1, -1, -1])


def test_max_size_comes_after(tmp_path):
    capture = write_nerfstudio(make(PATH), tmp_path / "capture")
    small, whole = recognise(capture.root, max_size=40), recognise(capture.root)
    assert (small.facts["width"], small.facts["height"]) == (40, 32)
    np.testing.assert_allclose(small.K[:, :2], whole.K[:, :2] / 2)
    np.testing.assert_array_equal(small.crop, whole.crop)


def test_captures_of_one_size_have_no_crop(images_capture, tmp_path):
    assert "crop" not in run_frames(images_capture.root, tmp_path).artifact


def test_masks_follow_their_pictures(tmp_path):
    options = Options(backdrop="room", rig="arc", cameras=4, times=2, sizes=((80, 64), (120, 96)), width=80, height=64, samples=2)
    capture = write_panoptic(make(options), tmp_path / "capture")
    ran = run_frames(capture.root, tmp_path)
    frames = FrameSet(ran.artifact, capture.root)
    stored = np.asarray(Image.open(capture.root / "seg/1/000000.png").convert("L"))
    assert stored.shape == (96, 120)
    mask = frames.mask(frames.names.index("ims/1/000000.jpg"))
    assert mask.shape == (64, 80) and mask.mean() == pytest.approx(stored.mean(), rel=0.05)


def test_what_is_said_of_sizes_that_cannot_be(n3v_capture, images_capture, tmp_path):
    root = shutil.copytree(images_capture.root, tmp_path / "hinted")
    (root / "K.txt").write_text("100 0 48 0 100 40 0 0 1")
    Image.new("RGB", (48, 40)).save(root / "003.png")
    with pytest.raises(CaptureError, match=r"K\.txt: one camera matrix for images of 2 sizes; remove the file"):
        recognise(root)
    rig = tmp_path / "rig"
    for camera in range(4):
        (rig / f"cam{camera:02d}").mkdir(parents=True)
        for t in range(3):
            Image.new("RGB", (80, 64) if (camera, t) != (2, 1) else (96, 64)).save(rig / f"cam{camera:02d}" / f"{t}.png")
    shutil.copy(n3v_capture.root / "poses_bounds.npy", rig)
    with pytest.raises(CaptureError, match=r"cam02/1\.png: 96x64, but cam02/0\.png of the same camera is 80x64"):
        recognise(rig)
