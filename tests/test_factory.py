"""The factory's truth is exact: shapes against algebra, flow against warped images, files against the cameras they came from."""

import json
from pathlib import Path

import numpy as np
import pytest
from factory import Box, Camera, Checker, Motion, Object, Options, Scene, Sphere, look_at, make, optical_flow, render
from factory.camera import intrinsics
from factory.render import cast
from factory.writers import OPENGL_FROM_OPENCV, flatten
from PIL import Image


def front_camera(width=40, height=30, fov=60.0, distortion=(0.0, 0.0, 0.0, 0.0)) -> Camera:
    return Camera(intrinsics(width, height, fov), look_at(np.array([0.0, -5.0, 0.0]), np.zeros(3)), width, height, distortion)


def test_look_at_is_an_opencv_camera():
    camera = front_camera()
    R = camera.cam_from_world[:3, :3]
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-15)
    assert np.linalg.det(R) == pytest.approx(1.0)
    pixels, depth = camera.project(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]))
    np.testing.assert_allclose(depth, 5.0)
    np.testing.assert_allclose(pixels[0], [20.0, 15.0])
    assert pixels[1, 0] > 20.0, "world x is to the right"
    assert pixels[2, 1] < 15.0, "world z is up, image v is down"


@pytest.mark.parametrize("distortion", [(0.0, 0.0, 0.0, 0.0), (-0.06, 0.01, 0.001, -0.0005)])
def test_rays_and_projection_are_inverse(distortion):
    camera = front_camera(distortion=distortion)
    origin, directions = camera.rays(camera.pixel_centres())
    pixels, depth = camera.project(origin + 3.0 * directions)
    np.testing.assert_allclose(pixels, camera.pixel_centres(), atol=1e-9)
    np.testing.assert_allclose(depth, 3.0)


def test_hits_lie_on_the_surface():
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(500, 3))
    sphere, box = Sphere(0.7), Box((0.5, 0.6, 0.7))
    origin = np.array([0.3, -2.0, 0.4])
    t = sphere.intersect(origin, directions)
    hit = np.isfinite(t)
    assert hit.any() and not hit.all()
    np.testing.assert_allclose(np.linalg.norm(origin + t[hit, None] * directions[hit], axis=1), 0.7)
    t = box.intersect(origin, directions)
    hit = np.isfinite(t)
    inside = np.abs(origin + t[hit, None] * directions[hit]) / [0.5, 0.6, 0.7]
    assert hit.any() and not hit.all()
    np.testing.assert_allclose(inside.max(axis=1), 1.0)


def test_a_room_is_seen_from_inside_in_every_direction():
    directions = np.random.default_rng(1).normal(size=(200, 3))
    room = Box((4.0, 4.0, 2.0), inside=True)
    t = room.intersect(np.array([1.0, 2.0, -0.5]), directions)
    assert np.isfinite(t).all() and (t > 0).all()


def test_alpha_is_the_exact_area_up_to_sampling():
    """A cube face seen head on covers a rectangle whose area is known."""
    scene = Scene((Object("cube", Box((1.0, 1.0, 1.0)), Checker(0.25)),))
    camera = front_camera(64, 64, 60.0)
    alpha = render(scene, camera, 0.0, samples=8).image[..., 3]
    side = 2.0 * camera.K[0, 0] / 4.0  # the front face is 4 away
    assert alpha.sum() == pytest.approx(side**2, rel=0.01)


def test_occlusion_and_depth():
    near = Object("near", Sphere(0.5), Checker(0.2), Motion((0.0, -2.0, 0.0)))
    far = Object("far", Box((2.0, 0.5, 2.0)), Checker(0.2), Motion((0.0, 1.0, 0.0)))
    truth = render(Scene((far, near)), front_camera(41, 31), 0.0, samples=1)
    assert truth.object[15, 20] == 1 and truth.depth[15, 20] == pytest.approx(2.5)
    assert truth.object[15, 30] == 0 and truth.depth[15, 30] == pytest.approx(5.5)
    assert truth.mask(1).sum() > 0 and (truth.coverage.sum(-1) <= 1.0).all()


def test_same_options_same_bits():
    first, second = make(Options(seed=3)), make(Options(seed=3))
    view = first.views[4]
    images = [render(s.scene, s.views[4].camera, view.time, 2).image for s in (first, second)]
    np.testing.assert_array_equal(*images)
    assert not np.array_equal(make(Options(seed=4)).views[0].camera.cam_from_world, first.views[0].camera.cam_from_world)


def test_motion_zero_means_that_nothing_moves():
    assert not make(Options(motion=0.0)).scene.moves
    assert make(Options()).scene.moves


def test_squash_keeps_the_volume():
    for time in (0.1, 0.3, 0.8):
        assert np.linalg.det(Motion(squash=0.4).world_from_object(time)[:3, :3]) == pytest.approx(1.0)


@pytest.mark.parametrize("deform", [0.0, 0.3])
def test_flow_carries_brightness(deform):
    """Sampling the second frame's surface at the flow's end gives the first frame's colour, for every visible pixel."""
    synthetic = make(Options(backdrop="room", rig="path", times=6, width=60, height=44, fov_degrees=60.0, deform=deform))
    first, second = synthetic.views[1], synthetic.views[2]
    flow = optical_flow(synthetic.scene, first.camera, first.time, second.time, second.camera)
    assert 0.5 < flow.visible.mean() < 1.0
    assert np.linalg.norm(flow.flow[flow.visible], axis=-1).max() > 1.0

    ends = (first.camera.pixel_centres() + flow.flow)[flow.visible]
    here = cast(synthetic.scene, first.time, *first.camera.rays(first.camera.pixel_centres()[flow.visible]))
    there = cast(synthetic.scene, second.time, *second.camera.rays(ends))
    np.testing.assert_array_equal(there.object, here.object)
    np.testing.assert_allclose(there.local, here.local, atol=1e-6)


def test_flow_forward_and_back_returns():
    synthetic = make(Options(rig="arc", cameras=2, times=4, width=48, height=48))
    camera = synthetic.views[0].camera
    forward = optical_flow(synthetic.scene, camera, 0.2, 0.5)
    moved = forward.visible & (np.abs(forward.flow).sum(-1) > 0.5)
    assert moved.sum() > 20
    static = (forward.object == 0) & forward.visible
    np.testing.assert_allclose(forward.flow[static], 0.0, atol=1e-9)


def test_occluded_points_are_not_visible():
    """A sphere that slides before a wall hides part of it later."""
    wall = Object("wall", Box((3.0, 0.2, 3.0)), Checker(0.3), Motion((0.0, 1.0, 0.0)))
    ball = Object("ball", Sphere(0.6), Checker(0.3), Motion((0.0, -1.0, 0.0), slide=(2.0, 0.0, 0.0)))
    scene, camera = Scene((wall, ball)), front_camera(60, 45)
    flow = optical_flow(scene, camera, 0.0, 1.0)
    hidden = (flow.object == 0) & ~flow.visible
    later = render(scene, camera, 1.0, samples=1)
    inside = later.object == 1
    np.testing.assert_array_equal(hidden, inside & (flow.object == 0))


def test_dnerf_files_hold_the_truth(dnerf_capture):
    options = dnerf_capture.synthetic.options
    for split, count in (("train", options.times), ("val", options.val), ("test", options.test)):
        meta = json.loads((dnerf_capture.root / f"transforms_{split}.json").read_text())
        assert len(meta["frames"]) == count
        for frame, view in zip(meta["frames"], dnerf_capture.synthetic.split(split)):
            pose = np.array(frame["transform_matrix"]) @ OPENGL_FROM_OPENCV
            np.testing.assert_allclose(pose, view.camera.world_from_cam, atol=1e-14)
            image = Image.open(dnerf_capture.root / f"{frame['file_path']}.png")
            assert image.mode == "RGBA" and image.size == (64, 64)


def test_n3v_files_hold_the_truth(n3v_capture):
    av = pytest.importorskip("av")
    rows = np.load(n3v_capture.root / "poses_bounds.npy", allow_pickle=False)
    assert rows.shape == (4, 17)
    view = n3v_capture.views[0]
    pose = rows[0, :15].reshape(3, 5)
    right, down, forward = pose[:, 1], pose[:, 0], -pose[:, 2]
    np.testing.assert_allclose(np.stack([right, down, forward, pose[:, 3]], 1), view.camera.world_from_cam[:3])
    np.testing.assert_allclose(pose[:, 4], [64, 80, view.camera.K[0, 0]])
    with av.open(str(n3v_capture.root / "cam00.mp4")) as container:
        decoded = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    assert len(decoded) == 6
    truth = flatten(render(n3v_capture.synthetic.scene, view.camera, view.time, 3))
    grey = np.array([0.299, 0.587, 0.114])  # 4:2:0 halves the resolution of colour, brightness stays
    assert np.abs((decoded[0] - truth.astype(float)) @ grey).mean() < 4.0, "the codec keeps the picture"


def test_panoptic_files_hold_the_truth(panoptic_capture):
    meta = json.loads((panoptic_capture.root / "train_meta.json").read_text())
    assert np.array(meta["w2c"]).shape == (4, 3, 4, 4) and np.array(meta["k"]).shape == (4, 3, 3, 3)
    assert json.loads((panoptic_capture.root / "test_meta.json").read_text())["cam_id"] == [[0]] * 4
    mask = np.asarray(Image.open(panoptic_capture.root / "seg" / "1" / "000002.png"))
    view = next(v for v in panoptic_capture.views if (v.camera_index, v.time_index) == (1, 2))
    truth = render(panoptic_capture.synthetic.scene, view.camera, view.time, 1)
    np.testing.assert_array_equal(mask, truth.object > 0)


def test_nerfstudio_and_image_folders(nerfstudio_capture, images_capture, video_capture):
    meta = json.loads((nerfstudio_capture.root / "transforms.json").read_text())
    assert meta["k1"] == -0.06 and len(meta["frames"]) == 10
    assert all((nerfstudio_capture.root / frame["file_path"]).is_file() for frame in meta["frames"])
    assert sorted(p.name for p in images_capture.root.iterdir()) == list(images_capture.files)
    assert Path(video_capture).stat().st_size > 1000


def test_colmap_model_agrees_with_the_cameras(colmap_capture):
    pycolmap = pytest.importorskip("pycolmap")
    model = pycolmap.Reconstruction(str(colmap_capture.root / "sparse" / "0"))
    assert model.num_images() == len(colmap_capture.views)
    for image in model.images.values():
        view = colmap_capture.views[colmap_capture.files.index(f"images/{image.name}")]
        np.testing.assert_allclose(image.cam_from_world().matrix(), view.camera.cam_from_world[:3], atol=1e-12)
