"""Pictures of several sizes in one capture come to one size, and their cameras stay true."""

import json
import shutil

import cv2
import numpy as np
import pytest
from e4dgs.pipeline import CaptureError
from e4dgs.stages.captures import recognise
from e4dgs.stages.captures.assembly.common_size import common_size, crop, told
from e4dgs.stages.captures.assembly.quarter_turns import turned_alike
from e4dgs.stages.captures.reading import Shot
from e4dgs.stages.shared.frameset import FrameSet
from factory import Camera, Options, make, render, write_colmap, write_dnerf, write_images, write_n3v, write_nerfstudio, write_panoptic
from factory.writers import flatten, write_videos
from PIL import Image
from run_stage import run_frames

SIZES = ((80, 64), (80, 64), (120, 96), (64, 80))  # most, larger of the same shape, upright
PATH = Options(backdrop="room", rig="path", times=8, sizes=SIZES, samples=3, fov_degrees=60.0)
RIG = Options(backdrop="room", rig="arc", cameras=4, times=3, sizes=((80, 64), (120, 90)), samples=3, fov_degrees=60.0)

CLOCKWISE = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]


def assert_true_to_their_cameras(frames, capture, views, least):
    """Each picture equals a render with the K that the frameset gives, and not one a pixel away."""
    assert (frames.width, frames.height) == (80, 64)
    for i, view in enumerate(views):
        assert frames.image(i).shape[:2] == (64, 80)
        turn = frames.cam_from_world[i, :3, :3] @ view.camera.cam_from_world[:3, :3].T
        np.testing.assert_allclose(turn, CLOCKWISE if view.camera.height > view.camera.width else np.eye(3), atol=1e-4)
        camera = Camera(frames.K[i], frames.cam_from_world[i], 80, 64)
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
    held = np.stack([view.camera.cam_from_world for view in views])
    np.testing.assert_allclose(frames.held(np.arange(len(frames))), held, atol=1e-6)


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
    assert common_size([(160, 128), (640, 512)]) == (640, 512) and common_size([(320, 256), (640, 512)]) == (320, 256)
    assert crop((120, 96), (80, 64)) == (0, 0, 120, 96)
    assert crop((64, 80), (80, 64)) == (0, 14, 64, 51)
    assert crop((81, 64), (80, 64)) == (0, 0, 80, 64)
    assert crop((1, 500), (80, 64)) == (0, 249, 1, 1)


def test_what_is_lost_is_said(tmp_path):
    capture = write_images(make(PATH), tmp_path / "photos")
    turned, note = recognise(capture.root, fps=30).notes
    assert turned == "2 of 8 pictures stand across the others (first 003.png): they are turned by a quarter, so that less is cropped"
    assert note == "2 of 8 pictures are not 80x64 px as most are (first 002.png, 120x96): they are scaled to that size, whole"


def photos(root, orientations):
    """Photos of 16x12 px with the EXIF ``orientations``, each with a mask and with depth as it is shown; returns what the sensor saw."""
    for folder in ("photos/masks", "photos/depth"):
        (root / folder).mkdir(parents=True)
    seen = np.random.default_rng(0).integers(1, 256, (len(orientations), 12, 16), np.uint8)
    for i, (orientation, values) in enumerate(zip(orientations, seen, strict=True)):
        exif = Image.Exif()
        exif[0x0112] = orientation
        Image.fromarray(values).convert("RGB").save(root / f"photos/{i}.png", exif=exif)
        shown = np.rot90(values, {1: 0, 6: -1, 8: 1}[orientation])
        Image.fromarray(np.where(shown > 127, 255, 0).astype(np.uint8)).save(root / f"photos/masks/{i}.png")
        Image.fromarray(shown.astype(np.uint16)).save(root / f"photos/depth/{i}.png")
    return root / "photos", seen


@pytest.mark.parametrize(("orientations", "turn"), [([1, 1, 6, 1, 8, 1], 0), ([6, 1], 0), ([6, 6, 1, 6, 6], -1), ([8, 1, 8, 8], 1)])
def test_photos_of_a_phone_held_both_ways_are_whole(tmp_path, orientations, turn):
    """All lie as the sensor saw them, turned as most photos ask, so that these stand upright."""
    root, seen = photos(tmp_path, orientations)
    frames = FrameSet(run_frames(root, tmp_path).artifact, root)
    assert frames.crop is None and (frames.width, frames.height) == ((12, 16) if turn else (16, 12))
    for i, values in enumerate(seen):
        expected = np.rot90(values, turn)
        np.testing.assert_array_equal(frames.original(i)[..., 0], expected)
        np.testing.assert_array_equal(frames.kept(i), expected > 127)
        np.testing.assert_array_equal(frames.depth(i)[0], expected)


def test_tangential_distortion_turns_with_its_picture(tmp_path):
    shot = Shot("a", 0, 0.0, (60, 80), file="a", K=np.array([[50.0, 0, 28], [0, 55, 41], [0, 0, 1]]), cam_from_world=np.eye(4))
    shot.distortion = np.array([0.1, 0.01, 0.02, -0.03])
    (turned, _), turns = turned_alike(tmp_path, [shot, Shot("b", 1, 0.0, (80, 60))], (80, 60), upright=False)
    assert turns == (6, 1) and turned.size == (80, 60)
    point = np.array([[0.3, -0.2, 1.0]])
    (x, y), (across, down) = (
        cv2.projectPoints(point, s.cam_from_world[:3, :3], np.zeros(3), s.K, s.distortion)[0].ravel() for s in (shot, turned)
    )
    np.testing.assert_allclose((across, down), (80 - y, x))


def test_videos_of_upright_and_lying_phones_are_whole(tmp_path):
    """The clips of a phone that stood upright are turned, the others stay."""
    synthetic = make(Options(backdrop="room", rig="arc", cameras=3, times=4, sizes=((80, 64), (80, 64), (64, 80)), samples=2))
    capture = write_videos(synthetic, tmp_path / "event", crf=4)
    ran = run_frames(capture.root, tmp_path, sync="frames")
    frames = FrameSet(ran.artifact, capture.root)
    assert frames.crop is None and (frames.width, frames.height) == (80, 64)
    for i in range(len(frames)):
        view = next(v for v in capture.views if v.camera_index == frames.camera[i] and v.time == frames.time[i])
        truth = flatten(render(synthetic.scene, view.camera, view.time, 2))
        truth = truth if truth.shape[1] == 80 else np.rot90(truth, -1)
        assert np.abs(frames.original(i).astype(float) - truth).mean() < 8
    assert any("4 of 12 pictures stand across the others (first" in line for line in ran.lines)


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
