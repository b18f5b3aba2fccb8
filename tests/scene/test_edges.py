"""Edges: strong on a step, graded by contrast, steady under noise, defined on every size."""

import numpy as np
import pytest
from e4dgs.scene.edges import edge_mask_canny, edge_weights, near_edges


def step(height: int = 40, width: int = 60, low: int = 60, high: int = 180) -> np.ndarray:
    image = np.full((height, width, 3), low, np.uint8)
    image[:, width // 2 :] = high
    return image


def test_a_step_is_an_edge_and_the_weight_falls_off_beside_it():
    weights = edge_weights(step())
    assert weights.dtype == np.uint8 and weights.shape == (40, 60)
    row = weights[20].astype(int)
    assert row.max() == 255 and abs(int(row.argmax()) - 30) <= 1
    assert row[:22].max() == 0 and row[40:].max() == 0
    peak = int(row.argmax())
    assert 120 < row[peak + 1] < 200 or 120 < row[peak - 1] < 200  # exp(-1/2) = 0.61 at one pixel
    assert (np.diff(row[peak + 1 : peak + 5]) <= 0).all()


def test_weight_grows_with_contrast():
    peaks = [int(edge_weights(step(low=100, high=100 + h)).max()) for h in (4, 30, 50, 120)]
    assert peaks == sorted(peaks)
    assert peaks[0] == 0 and peaks[-1] == 255 and len(set(peaks)) >= 3


def test_noise_of_a_camera_is_not_an_edge():
    noisy = np.clip(128 + np.random.default_rng(0).normal(0, 2, (80, 100, 3)), 0, 255).astype(np.uint8)
    assert not edge_weights(noisy).any()
    assert not edge_mask_canny(noisy).any()


def test_an_edge_between_colours_of_different_brightness_has_one_contour():
    mask = edge_mask_canny(step())
    assert mask.dtype == bool
    assert (mask[5:-5].sum(1) == 1).all()
    assert np.abs(np.nonzero(mask[20])[0] - 29.5).max() <= 1


def test_near_edges_is_a_euclidean_disk():
    mask = np.zeros((11, 11), bool)
    mask[5, 5] = True
    y, x = np.mgrid[:11, :11]
    assert np.array_equal(near_edges(mask, 2.0), np.hypot(x - 5, y - 5) <= 2.0)
    assert not near_edges(np.zeros((4, 4), bool), 2.0).any()


@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (8, 8), (17, 33)])
def test_small_images_have_an_answer(shape: tuple[int, int]):
    image = np.random.default_rng(1).integers(0, 256, (*shape, 3), dtype=np.uint8)
    assert edge_weights(image).shape == shape
    assert edge_mask_canny(image).shape == shape


@pytest.mark.parametrize(
    "bad", [np.zeros((8, 8), np.uint8), np.zeros((8, 8, 4), np.uint8), np.zeros((8, 8, 3)), np.zeros((0, 8, 3), np.uint8)]
)
def test_other_shapes_and_dtypes_are_refused(bad: np.ndarray):
    with pytest.raises(ValueError, match=r"uint8 \[H, W, 3\]"):
        edge_weights(bad)
