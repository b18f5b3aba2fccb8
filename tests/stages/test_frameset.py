"""`FrameSet`: pictures fit the pinhole camera, alpha is straight, poses come from the files or from structure from motion."""

import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import pytest
from e4dgs.pipeline import Artifact, ArtifactWriter, StageError
from e4dgs.stages.shared.frameset import FrameSet
from e4dgs.stages.shared.posed_frameset import PosedFrameSet
from e4dgs.vision.images import pictures
from factory import Camera, render
from factory.writers import flatten
from run_stage import run_frames


def frames_of(path, folder, **settings):
    """The artifact of `frames`, and the capture's folder."""
    ran = run_frames(path, folder, **settings)
    return ran.artifact, ran.context.capture.root


@pytest.fixture
def open_set(tmp_path):
    def make(path, **settings):
        return FrameSet(*frames_of(path, tmp_path, **settings))

    return make


def psnr(a, b):
    return 10 * np.log10(255**2 / np.mean((a.astype(float) - b.astype(float)) ** 2))


def test_splits_and_size(open_set, dnerf_capture):
    frames = open_set(dnerf_capture.root)
    assert (len(frames), len(frames.train), len(frames.val), len(frames.test)) == (18, 12, 2, 4)
    assert frames.registered.all() and frames.background == "white" and (frames.width, frames.height) == (64, 64)
    assert frames.mask(0) is None


def test_image_has_straight_alpha_and_composites_on_the_background(open_set, dnerf_capture):
    frames = open_set(dnerf_capture.root, background="black")
    picture = frames.image(3)
    assert picture.shape == (64, 64, 4) and picture.dtype == np.uint8
    view = dnerf_capture.views[3]
    truth = render(dnerf_capture.synthetic.scene, view.camera, view.time, dnerf_capture.synthetic.options.samples)
    np.testing.assert_allclose(frames.composited(3), flatten(truth, background=0.0), atol=1)


def test_composite_is_exact():
    values = np.arange(256, dtype=np.uint8)
    picture = np.stack(np.meshgrid(values, values, indexing="ij"), -1)[..., [0, 0, 0, 1]]
    colour, alpha = picture[..., :3].astype(float), picture[..., 3:] / 255.0
    np.testing.assert_array_equal(pictures.composite(picture, "white"), np.floor(colour * alpha + 255 * (1 - alpha) + 0.5))
    np.testing.assert_array_equal(pictures.composite(picture, "black"), np.floor(colour * alpha + 0.5))


def test_undistorted_picture_is_the_pinhole_camera_s(open_set, nerfstudio_capture):
    """Against a render of the same scene without distortion; a shift of half a pixel would already fail."""
    frames = open_set(nerfstudio_capture.root)
    synthetic = nerfstudio_capture.synthetic
    for i in (0, 5):
        view = nerfstudio_capture.views[i]
        assert any(view.camera.distortion)
        pinhole = Camera(view.camera.K, view.camera.cam_from_world, view.camera.width, view.camera.height)
        truth = flatten(render(synthetic.scene, pinhole, view.time, synthetic.options.samples))[2:-2, 2:-2]
        ours = frames.image(i)
        quality = psnr(ours[2:-2, 2:-2], truth)
        shifted = psnr(cv2.warpAffine(ours, np.float32([[1, 0, 0.5], [0, 1, 0.5]]), (80, 64))[2:-2, 2:-2], truth)
        assert quality > psnr(frames.original(i)[2:-2, 2:-2], truth) + 3
        assert quality > shifted + 1


def test_max_size_scales_pictures_and_intrinsics_together(open_set, panoptic_capture):
    frames = open_set(panoptic_capture.root, max_size=40)
    view = next(v for v, f in zip(panoptic_capture.views, panoptic_capture.files) if f == frames.names[5])
    small = Camera(frames.K[5], frames.cam_from_world[5], 40, 32)
    truth = flatten(render(panoptic_capture.synthetic.scene, small, view.time, 4))
    assert frames.image(5).shape == (32, 40, 3)
    assert psnr(frames.image(5), truth) > 28


def test_resizing_does_not_bleed_hidden_colour():
    picture = np.zeros((4, 4, 4), np.uint8)
    picture[:, ::2] = (200, 100, 50, 255)
    picture[:, 1::2] = (0, 255, 0, 0)  # invisible green
    np.testing.assert_array_equal(pictures.resize(picture, 2, 2), np.full((2, 2, 4), (200, 100, 50, 128), np.uint8))


def test_masks(open_set, panoptic_capture):
    frames = open_set(panoptic_capture.root)
    i = frames.names.index("ims/1/000000.jpg")
    mask = frames.mask(i)
    assert mask.shape == (64, 80) and mask.dtype == np.uint8 and set(np.unique(mask)) == {0, 255}


def test_pictures_from_video(open_set, video_capture):
    frames = open_set(video_capture.root)
    assert frames.K is None and not frames.registered.any()
    assert len(frames.train) == 10, "before structure from motion every frame counts"
    assert frames.image(11).shape == (80, 96, 3)


def test_poses_of_structure_from_motion_replace_the_capture_s(tmp_path, video_capture):
    frames, root = frames_of(video_capture.root, tmp_path)
    (tmp_path / "poses").mkdir()
    out = ArtifactWriter(tmp_path / "poses")
    cam_from_world = np.stack([v.camera.cam_from_world for v in video_capture.views])
    cam_from_world[4] = np.nan
    K = np.stack([v.camera.K for v in video_capture.views])
    out.write("K", K)
    out.write("cam_from_world", cam_from_world)
    out.write("distortion", np.tile([-0.1, 0, 0, 0], (12, 1)).astype(np.float64))
    out.write("registered", np.isfinite(cam_from_world).all((1, 2)))
    out.write("points", np.zeros((5, 3)))
    out.write("point_colors", np.zeros((5, 3), np.uint8))
    out.finish({})
    posed = FrameSet(frames, root, Artifact(tmp_path / "poses"))
    np.testing.assert_array_equal(posed.K, K)
    np.testing.assert_array_equal(np.flatnonzero(~posed.registered), [4])
    np.testing.assert_array_equal(posed.train, [1, 2, 3, 5, 6, 7, 9, 10, 11])
    assert posed.points.shape == (5, 3)
    assert not np.array_equal(posed.image(1), posed.original(1)), "the lens found by structure from motion is undone"
    np.testing.assert_array_equal(posed.image(4), posed.original(4))


def test_threads_read_the_same_pictures(open_set, nerfstudio_capture):
    frames = open_set(nerfstudio_capture.root)
    alone = [frames.image(i) for i in range(10)]
    with ThreadPoolExecutor(8) as pool:
        for i, picture in enumerate(pool.map(frames.image, [i % 10 for i in range(80)])):
            np.testing.assert_array_equal(picture, alone[i % 10])


def test_opaque_pictures_beside_transparent_ones_get_an_alpha(open_set, dnerf_capture, tmp_path):
    from PIL import Image

    root = shutil.copytree(dnerf_capture.root, tmp_path / "mixed")
    Image.open(root / "train/r_000.png").convert("RGB").save(root / "train/r_000.png")
    frames = open_set(root)
    assert frames.image(0).shape == (64, 64, 4) and (frames.image(0)[..., 3] == 255).all()


def test_importing_it_costs_no_torch_and_no_opencv():
    code = "import sys, e4dgs.stages.shared.frameset; print([m for m in ('torch', 'cv2') if m in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip() == "[]"


def test_a_posed_frame_set_refuses_a_capture_without_poses(images_capture, dnerf_capture, tmp_path):
    posed = PosedFrameSet(run_frames(dnerf_capture.root, tmp_path / "posed").artifact, dnerf_capture.root)
    assert posed.K.shape == (len(posed), 3, 3) and posed.cam_from_world.shape == (len(posed), 4, 4)
    with pytest.raises(StageError, match="no poses"):
        PosedFrameSet(run_frames(images_capture.root, tmp_path / "bare").artifact, images_capture.root)
