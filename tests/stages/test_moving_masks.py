"""Masks of moving pixels gathered small: as large as the pictures, in the right place, the same however the work is cut."""

import itertools
from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import pytest
from e4dgs.stages.flow import moving_masks as module
from e4dgs.stages.flow.moving_masks import FIXED_SIZE, MovingMasks
from e4dgs.vision.flow.two_way import FlowPair

WIDTH, HEIGHT, FRAMES, STEP = 2 * FIXED_SIZE, 270, 7, 40
K = np.array([[400.0, 0, WIDTH / 2], [0, 400.0, HEIGHT / 2], [0, 0, 1]])


def clip() -> tuple[list[np.ndarray], list[np.ndarray], list[FlowPair]]:
    """A red square that crosses a textured wall; pictures, where the square is, and exact flow."""
    rng = np.random.default_rng(3)
    wall = cv2.resize(rng.integers(60, 190, (27, 48, 3), dtype=np.uint8), (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)
    pictures, squares = [], []
    for k in range(FRAMES):
        square = np.zeros((HEIGHT, WIDTH), bool)
        square[90:170, 60 + STEP * k : 160 + STEP * k] = True
        pictures.append(np.where(square[..., None], np.uint8([230, 20, 20]), wall))
        squares.append(square)
    pairs = []
    for first, second in itertools.pairwise(squares):
        forward, backward = (np.zeros((HEIGHT, WIDTH, 2), np.float32) for _ in range(2))
        forward[first, 0], backward[second, 0] = STEP, -STEP
        pairs.append(FlowPair(forward, backward, np.where(second & ~first, 0, 255).astype(np.uint8)))
    return pictures, squares, pairs


def masks(fixed: bool, posed: bool = True, stretch: int = module.STRETCH) -> tuple[list[np.ndarray], list[np.ndarray]]:
    pictures, squares, pairs = clip()
    poses = (np.tile(K, (FRAMES, 1, 1)), np.tile(np.eye(4), (FRAMES, 1, 1))) if posed else (None, None)
    gathered = MovingMasks(WIDTH, HEIGHT, *poses, fixed)
    for k, picture in enumerate(pictures):
        gathered.add_picture(k, picture)
    for k, pair in enumerate(pairs):
        gathered.add_pair(k, pair)
    with pytest.MonkeyPatch.context() as patch, ThreadPoolExecutor(2) as pool:
        patch.setattr(module, "STRETCH", stretch)
        found = [mask for job in gathered.masks(pool) for mask in job.result()]
    return found, squares


@pytest.mark.parametrize("fixed", [True, False])
@pytest.mark.parametrize("posed", [True, False])
def test_what_moves_is_masked_at_the_size_of_the_pictures(fixed, posed):
    found, squares = masks(fixed, posed)
    assert len(found) == FRAMES
    for mask, square in zip(found, squares):
        assert mask.shape == (HEIGHT, WIDTH) and mask.dtype == np.uint8 and set(np.unique(mask)) <= {0, 255}
        assert ((mask > 0) & square).sum() > 0.8 * ((mask > 0) | square).sum()


def test_the_masks_do_not_depend_on_how_the_work_is_cut():
    whole, parts = masks(False, stretch=100)[0], masks(False, stretch=2)[0]
    assert all(np.array_equal(a, b) for a, b in zip(whole, parts, strict=True))


def test_one_frame_has_an_empty_mask():
    gathered = MovingMasks(WIDTH, HEIGHT, None, None, fixed=False)
    gathered.add_picture(0, clip()[0][0])
    with ThreadPoolExecutor(1) as pool:
        (job,) = gathered.masks(pool)
        (mask,) = job.result()
    assert mask.shape == (HEIGHT, WIDTH) and not mask.any()
