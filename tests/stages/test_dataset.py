"""Measured flow as training reads it: at half resolution, with a weight for each pixel."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from e4dgs.scene.views import Views
from e4dgs.stages.shared.dataset import are_photos, load_views
from e4dgs.stages.shared.measured import measured_flow
from write_artifact import write_artifact

WIDTH, HEIGHT, FRAMES = 16, 8, 5
PAIRS = [(1, 2), (2, 3), (1, 3), (3, 4)]  # frame 0 has none, so that the number of a pair is not that of its frame
MOVING = 4  # columns from the left in which frame 1 moves, and one more in each later frame


def views() -> Views:
    """One camera; its last frame is held out."""
    index, blank = np.arange(FRAMES), np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    return Views(
        K=np.tile(np.eye(3), (FRAMES, 1, 1)),
        cam_from_world=np.tile(np.eye(4), (FRAMES, 1, 1)),
        time=index / (FRAMES - 1),
        camera=np.zeros(FRAMES, int),
        next=np.array([-1, 2, 3, 4, -1]),
        train=index[:-1],
        width=WIDTH,
        height=HEIGHT,
        load=lambda i: blank,
    )


def flow(folder: Path, moving: bool, confidence: int = 255):
    masks = np.zeros((FRAMES, HEIGHT, WIDTH), np.uint8)
    for i in range(1, FRAMES):
        masks[i, :, : MOVING + i - 1] = 255
    forward = np.tile(np.array([6, -2], np.float16), (len(PAIRS), HEIGHT, WIDTH, 1))
    forward[2] = 40  # to a frame that is not the next one
    arrays = {
        "pair": np.array(PAIRS, np.int32),
        "forward": forward,
        "confidence": np.full((len(PAIRS), HEIGHT, WIDTH), confidence, np.uint8),
    }
    return write_artifact(folder, arrays | ({"moving": masks} if moving else {}))


def test_what_moves_weighs_ten_times_as_much_as_what_is_static(tmp_path):
    of_frame = measured_flow(flow(tmp_path / "flow", moving=True), views())
    assert of_frame is not None
    _, first = of_frame(1)
    assert first.shape == (HEIGHT // 2, WIDTH // 2)
    assert first.numpy() == pytest.approx(np.tile([1.0] * 2 + [0.1] * 6, (HEIGHT // 2, 1)))
    _, second = of_frame(2)  # its own mask, which ends within a pixel of half the size
    assert second.numpy() == pytest.approx(np.tile([1.0] * 2 + [0.55] + [0.1] * 5, (HEIGHT // 2, 1)), abs=2e-3)  # masks are rounded


def test_without_masks_of_moving_pixels_all_weigh_the_same(tmp_path):
    of_frame = measured_flow(flow(tmp_path / "flow", moving=False), views())
    assert of_frame is not None
    assert (of_frame(1)[1] == 1).all() and (of_frame(2)[1] == 1).all()


@pytest.mark.parametrize(("masked", "moving", "static"), [(True, 0.2, 0.02), (False, 0.2, 0.2)])
def test_the_weight_is_that_of_the_flow_s_confidence(masked, moving, static, tmp_path):
    of_frame = measured_flow(flow(tmp_path / "flow", masked, confidence=51), views())
    assert of_frame is not None
    _, weight = of_frame(1)
    assert weight[:, :2].numpy() == pytest.approx(moving) and weight[:, 2:].numpy() == pytest.approx(static)


def test_flow_is_in_pixels_of_half_the_size(tmp_path):
    of_frame = measured_flow(flow(tmp_path / "flow", moving=True), views())
    assert of_frame is not None
    field, _ = of_frame(1)
    assert field.shape == (HEIGHT // 2, WIDTH // 2, 2)
    assert (field[..., 0] == 3).all() and (field[..., 1] == -1).all()


def test_frames_without_a_next_one_to_learn_from_have_none(tmp_path):
    of_frame = measured_flow(flow(tmp_path / "flow", moving=True), views())
    assert of_frame is not None
    assert [of_frame(i) is not None for i in range(FRAMES)] == [False, True, True, False, False], "frame 3 leads to one that is held out"
    assert measured_flow(None, views()) is None
    assert measured_flow(write_artifact(tmp_path / "none", {"pair": np.zeros((0, 2), np.int32)}), views()) is None


@pytest.mark.parametrize(
    ("camera", "time", "alpha", "photos"), [(0, 0, False, True), (1, 0, False, False), (0, 1, False, False), (0, 0, True, False)]
)
def test_only_pictures_of_one_camera_at_one_time_are_photos(camera, time, alpha, photos):
    frames = SimpleNamespace(camera=np.array([0, 0, camera]), alpha=alpha)
    assert are_photos(frames, np.array([0.0, 0, time])) is photos


@pytest.mark.parametrize(("static", "fixed_cameras", "one_time"), [(True, False, True), (True, True, False), (False, False, False)])
def test_frames_of_a_moving_camera_have_one_time_if_nothing_moves(tmp_path, static, fixed_cameras, one_time):
    seen = views()
    given = {name: getattr(seen, name) for name in ("K", "cam_from_world", "time", "camera", "next", "train", "width", "height")}
    frames = SimpleNamespace(**given, composited=seen.load, background="black", alpha=False, masked=False, fixed_cameras=fixed_cameras)
    found = write_artifact(tmp_path / "flow", {"pair": np.zeros((0, 2), np.int32)}, static=static)
    loaded = load_views(frames, found)
    assert (loaded.time == (np.zeros(FRAMES) if one_time else seen.time)).all()
    assert (loaded.recorder is not None) is one_time, "as photos, each may have an exposure of its own"
