"""Pictures of the static scene for the plane sweep: one per camera that stands still, frames along the path of cameras that move."""

import numpy as np
import pytest
from e4dgs.scene.seeds.clean_plates import FRAMES, LOOKS, MOST, clean_plates
from e4dgs.scene.training.curriculum import MIN_CAMERAS
from e4dgs.scene.views import Views

TIMES = 2 * FRAMES


def views(cameras: int) -> Views:
    """``cameras`` x `TIMES` pictures; at each time, another one of their 64 rows is white. Camera c is grey by 10 (c + 1)."""
    time, camera = (part.ravel() for part in np.meshgrid(np.linspace(0, 1, TIMES), np.arange(cameras), indexing="ij"))
    number = np.repeat(np.arange(TIMES), cameras)

    def load(i: int) -> np.ndarray:
        picture = np.full((TIMES, 8, 3), 10 * (camera[i] + 1), np.uint8)
        picture[number[i]] = 255
        return picture

    n = len(time)
    K, pose = np.tile(np.eye(3), (n, 1, 1)), np.tile(np.eye(4), (n, 1, 1))
    return Views(K, pose, time, camera, np.full(n, -1), np.arange(n), 8, TIMES, load)


@pytest.mark.parametrize("cameras", [1, 2, MIN_CAMERAS])
def test_a_camera_that_stands_still_has_one_picture_without_what_passes(cameras):
    plates = clean_plates(views(cameras), lambda i: None, fixed=True)
    assert len(plates.frames) == len(plates.pictures) == cameras
    for camera, picture in enumerate(plates.pictures):
        assert (picture == 10 * (camera + 1)).all()


def test_what_moves_most_of_the_time_is_not_static():
    seen = views(2)
    often = np.zeros((TIMES, 8), bool)
    often[:4] = True
    asked = []
    plates = clean_plates(seen, lambda i: asked.append(i) or (often if len(asked) % 2 else ~often), fixed=True)
    assert len(asked) == 2 * LOOKS, "nine a camera, so the first has one more of one kind of mask, the second of the other"
    first, second = plates.static
    assert (first == ~often).all() and (second == often).all()


@pytest.mark.parametrize(("cameras", "expected"), [(MIN_CAMERAS - 1, FRAMES), (MIN_CAMERAS, MIN_CAMERAS)])
def test_few_cameras_that_move_have_frames_of_their_whole_path(cameras, expected):
    seen = views(cameras)
    plates = clean_plates(seen, lambda i: None, fixed=False)
    assert len(plates.frames) == expected
    assert all((picture == seen.load(int(i))).all() for i, picture in zip(plates.frames, plates.pictures))


@pytest.mark.parametrize(("frames", "expected"), [(MOST, MOST), (MOST + 1, MOST)])
def test_a_long_video_of_a_static_scene_does_not_fill_the_memory(frames, expected):
    seen = views(frames)
    seen.train = seen.train[:frames]  # those of the first time
    plates = clean_plates(seen, lambda i: None, fixed=False)
    assert len(plates.pictures) == expected
    assert (plates.frames[0], plates.frames[-1]) == (0, frames - 1), "spread from end to end"
