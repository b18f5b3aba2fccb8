"""From flow between a lens's pictures to flow between pinhole pictures, against what the lens's equations say."""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from e4dgs.stages.flow.lens import straightened
from e4dgs.stages.flow.settings import FlowSettings
from e4dgs.stages.flow.stage import Flow
from e4dgs.vision.images.lenses import pinholes, straight_places, undistort_maps
from factory import Options, make, optical_flow, write_nerfstudio
from factory.camera import Camera
from run_stage import run_frames, run_stage

HEIGHT, WIDTH = 60, 80
LENS = np.array([[70.0, 0, 41.0], [0, 71.0, 29.0], [0, 0, 1]])
GRID = np.stack(np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT)), -1).astype(np.float32)
LENSES = [((-0.08, 0.01, 0.001, -0.0005), False), ((0.05, 0.0, 0.0, 0.0), False), ((-0.02, 0.004, 0.0, 0.0), True)]


def lens(terms: tuple[float, ...], fisheye: bool):
    """What a FrameSet says of frames with this lens."""
    distortion = np.array([terms])
    K = pinholes(LENS[None], distortion, np.array([fisheye], np.uint8), WIDTH, HEIGHT)[0][0]
    maps = undistort_maps(K, distortion[0], WIDTH, HEIGHT, LENS, fisheye)
    places = straight_places(K, distortion[0], WIDTH, HEIGHT, LENS, fisheye)
    return K, maps, places, SimpleNamespace(undistortion=lambda i: maps, straight_places=lambda i: places)


@pytest.mark.parametrize(("terms", "fisheye"), LENSES)
def test_the_way_back_undoes_the_way_there(terms, fisheye):
    _, maps, places, _ = lens(terms, fisheye)
    back = cv2.remap(places, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    assert places.shape == (HEIGHT, WIDTH, 2) and places.dtype == np.float32 and np.isfinite(places).all()
    assert np.abs(back - GRID)[1:-1, 1:-1].max() < 0.05


def test_places_of_a_lens_that_folds_its_picture_stay_finite_and_near():
    places = straight_places(LENS, np.array([-0.9, 0.0, 0.0, 0.0]), WIDTH, HEIGHT, LENS)
    assert np.isfinite(places).all() and (np.abs(places) <= 2 * max(WIDTH, HEIGHT)).all()


@pytest.mark.parametrize(("terms", "fisheye"), LENSES)
def test_exact_flow_of_a_camera_that_turns_and_shifts_its_picture(terms, fisheye):
    """The same points of the world before and after, through the lens's equations and through the pinhole's."""
    K, _, _, frames = lens(terms, fisheye)
    angle = 0.03
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    first, second = (
        Camera(LENS, np.block([[R, np.zeros((3, 1))], [np.zeros((1, 3)), np.ones((1, 1))]]), WIDTH, HEIGHT, terms, fisheye)
        for R in (np.eye(3), turn)
    )
    seen = second.project(first.rays(first.pixel_centres())[1])[0] - first.pixel_centres()
    pinhole = [Camera(K, camera.cam_from_world, WIDTH, HEIGHT) for camera in (first, second)]
    truth = pinhole[1].project(pinhole[0].rays(pinhole[0].pixel_centres())[1])[0] - pinhole[0].pixel_centres()
    found = straightened(frames, 0, 1, seen.astype(np.float32))
    inner = np.s_[4:-4, 6:-6]
    assert np.abs(found - truth)[inner].max() < 0.06 and np.abs(found - truth)[inner].mean() < 0.02
    assert np.abs(truth).max() > 1.5


def test_without_a_lens_flow_is_what_it_was():
    flow = np.random.default_rng(0).normal(size=(HEIGHT, WIDTH, 2)).astype(np.float32)
    assert straightened(SimpleNamespace(undistortion=lambda i: None, straight_places=lambda i: None), 0, 1, flow) is flow


def test_measured_through_a_lens_it_agrees_with_exact_flow_between_pinhole_pictures(tmp_path):
    options = Options(
        backdrop="room",
        rig="path",
        times=5,
        width=160,
        height=120,
        samples=2,
        fov_degrees=60.0,
        motion=0.2,
        distortion=(-0.06, 0.01, 0.001, -0.0005),
    )
    capture = write_nerfstudio(make(options), tmp_path / "capture")
    frames = run_frames(capture.root, tmp_path, holdout=0)
    settings = FlowSettings(detect_static=False, moving=False)
    flow = run_stage(Flow(), frames.context.capture, tmp_path, settings, {"frames": frames.artifact, "poses": None}).artifact
    K, forward, confidence = frames.artifact.read("K"), flow.read("forward").astype(float), flow.read("confidence")
    assert flow.read("lens_forward").shape == forward.shape
    errors, lengths = [], []
    for p, (i, j) in enumerate(flow.read("pair")):
        cameras = [Camera(K[k], capture.views[k].camera.cam_from_world, 160, 120) for k in (i, j)]
        truth = optical_flow(capture.synthetic.scene, cameras[0], capture.views[i].time, capture.views[j].time, cameras[1])
        sure = truth.visible & (confidence[p] == 255)
        errors.append(np.linalg.norm(forward[p] - truth.flow, axis=-1)[sure])
        lengths.append(np.linalg.norm(truth.flow, axis=-1)[sure])
    assert np.concatenate(errors).size > 0.3 * len(errors) * 160 * 120
    assert np.median(np.concatenate(errors)) < 0.1 * np.median(np.concatenate(lengths))
