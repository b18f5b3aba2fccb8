"""What a glance decides: pairs between which nothing moves, and the size at which flow is measured."""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from e4dgs.stages.flow.scout import ENOUGH, glance, no_motion, working_size


def texture(height: int = 120, width: int = 160, seed: int = 0) -> np.ndarray:
    noise = np.random.default_rng(seed).integers(60, 200, (height // 6, width // 6, 3), dtype=np.uint8)
    return cv2.resize(noise, (width, height), interpolation=cv2.INTER_CUBIC)


def shifted(image: np.ndarray, pixels: float) -> np.ndarray:
    height, width = image.shape[:2]
    move = np.array([[1.0, 0.0, pixels], [0.0, 1.0, 0.0]])
    return cv2.warpAffine(image, move, (width, height), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)


@pytest.mark.parametrize(("noise", "gain"), [(0, 0), (3, 0), (2, 6)])
def test_noise_and_brightness_are_no_motion(noise, gain):
    rng, image = np.random.default_rng(1), texture().astype(float)
    pair = [np.clip(image + k * gain + rng.normal(0, noise, image.shape), 0, 255).astype(np.uint8) for k in range(2)]
    assert no_motion(glance(pair[0]), glance(pair[1]))


def test_a_small_thing_that_moves_is_motion_and_a_moving_camera_too():
    image = texture()
    moved = image.copy()
    moved[50:58, 70:78] = (230, 30, 30)
    assert not no_motion(glance(image), glance(moved))
    assert not no_motion(glance(image), glance(shifted(image, 0.5)))


def test_the_limit_is_five_grey_levels():
    image = np.full((40, 40, 3), 100, np.uint8)
    for step, still in ((5, True), (6, False)):
        moved = image.copy()
        moved[10:25, 10:25] += step
        assert no_motion(glance(image), glance(moved)) is still


def frames(width: int, step: float, count: int = 4) -> SimpleNamespace:
    images = [shifted(texture(width * 3 // 4, width), step * k) for k in range(count)]
    return SimpleNamespace(width=width, height=width * 3 // 4, both=lambda i: (images[i], images[i]), next=np.arange(1, count + 1))


@pytest.mark.parametrize(
    ("width", "step", "max_size", "expected"),
    [
        (1200, 6.0, 960, 960),  # much motion
        (1200, 0.8, 960, 480),  # little
        (1200, 0.8, None, 600),
        (480, 0.8, 960, 480),  # small already: nothing is looked at
        (200, 0.8, 64, 64),
    ],
)
def test_little_motion_needs_half_the_size(width, step, max_size, expected):
    size, motion = working_size(frames(width, step), [0, 1, 2], max_size)
    assert size == expected
    if min(width, max_size or width) > ENOUGH:
        assert motion == pytest.approx(step, abs=1.0)
