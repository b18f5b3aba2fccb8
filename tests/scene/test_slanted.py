"""Depth from slanted windows: the correlation against an oracle, a floor that no sweep of parallel planes finds, threads, refusals."""

import cv2
import numpy as np
import pytest
from e4dgs.scene import _kernels
from e4dgs.scene.seeds.slanted import refine
from e4dgs.scene.seeds.sweep import AGREEING, LEAST_SCORE

WIDTH, HEIGHT, FOCAL = 120, 90, 110.0
K = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]])
NORMAL, DISTANCE = np.array([0.0, 0.95, 0.312]), 1.4  # a floor in front of the camera: NORMAL . X = DISTANCE, y down
RIGHT = ((0.35, 0.0, 0.0), (-0.35, 0.05, 0.0), (0.2, 0.1, 0.2))


def floor():
    """The floor as the camera sees it, as three others do, where they see it, and its true inverse depth."""
    rng = np.random.default_rng(0)
    tiles = cv2.GaussianBlur(rng.uniform(0, 255, (600, 600)).astype(np.float32), (0, 0), 1.5) * 4 - 380
    rows, columns = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    rays = np.stack([(columns - WIDTH / 2) / FOCAL, (rows - HEIGHT / 2) / FOCAL, np.ones((HEIGHT, WIDTH))], -1)

    def seen_from(centre):
        depth = (DISTANCE - NORMAL @ centre) / np.maximum(rays @ NORMAL, 1e-3)
        at = rays * depth[..., None] + centre
        return cv2.remap(tiles, (at[..., 0] * 60 + 300).astype(np.float32), (at[..., 2] * 60 + 100).astype(np.float32), cv2.INTER_LINEAR)

    to = np.stack([K @ np.hstack([np.linalg.inv(K), -np.array(c)[:, None]]) for c in RIGHT])
    return seen_from(np.zeros(3)), [seen_from(np.array(c)) for c in RIGHT], to, (rays @ NORMAL / DISTANCE).astype(np.float32)


def correlation(image, other, to, x, y, plane):
    """The oracle, one pixel at a time in double precision."""
    samples = [(dx, dy) for dy in range(-3, 4) for dx in range(-3, 4) if (dx + dy) % 2 == 0]
    values, theirs, weights = [], [], []
    for dx, dy in samples:
        inside = 0 <= x + dx < WIDTH and 0 <= y + dy < HEIGHT
        mine = float(image[np.clip(y + dy, 0, HEIGHT - 1), np.clip(x + dx, 0, WIDTH - 1)])
        change = (mine - float(image[y, x])) / 40
        weights.append(np.exp(-0.5 * change**2 - (dx * dx + dy * dy) / 18) if inside else 0.0)
        u, v, w = to @ [x + 0.5 + dx, y + 0.5 + dy, 1, plane[0] + plane[1] * dx + plane[2] * dy]
        u, v = np.clip(u / w - 0.5, 0, WIDTH - 1.001), np.clip(v / w - 0.5, 0, HEIGHT - 1.001)
        a, b = u - int(u), v - int(v)
        patch = other[int(v) : int(v) + 2, int(u) : int(u) + 2].astype(float)
        theirs.append((patch[0] @ [1 - a, a]) * (1 - b) + (patch[1] @ [1 - a, a]) * b)
        values.append(mine)
    values, theirs, weights = np.array(values), np.array(theirs), np.array(weights) / np.sum(weights)
    values, theirs = values - weights @ values, theirs - weights @ theirs
    return weights @ (values * theirs) / np.sqrt((weights @ values**2) * (weights @ theirs**2))


def test_the_score_is_the_mean_correlation_of_the_images_that_agree_best():
    image, others, to, truth = floor()
    rng = np.random.default_rng(1)
    planes = np.stack([truth * rng.uniform(0.97, 1.03, truth.shape), *rng.normal(0, 0.002, (2, *truth.shape))]).astype(np.float32)
    score = np.empty_like(truth)
    plain = np.ascontiguousarray(np.stack(others), np.float32), np.ascontiguousarray(to, np.float32)
    _kernels.patch_match(image.astype(np.float32), *plain, AGREEING, (0.01, 2.0), 0.01, FOCAL, 0, None, planes, score, 1)
    for x, y in ((30, 60), (70, 50), (60, 80), (2, 88), (117, 70)):
        each = []
        for one, pose in zip(others, to):
            u, v, w = pose @ [x + 0.5, y + 0.5, 1, planes[0, y, x]]
            shown = 0 <= u / w < WIDTH and 0 <= v / w < HEIGHT
            each.append(correlation(image, one, pose, x, y, planes[:, y, x]) if shown else -1.0)
        assert score[y, x] == pytest.approx(np.mean(sorted(each)[-AGREEING:]), abs=2e-4)


def found_of(iterations):
    """Share of the floor whose depth is found to 1 %, after a first guess like that of a sweep in steps."""
    image, others, to, truth = floor()
    steps = 40
    rough = np.round(truth * steps) / steps
    found, score = refine(image, others, to, AGREEING, rough, (1e-3, 1.0), steps, FOCAL, iterations)
    here = np.zeros(truth.shape, bool)
    here[HEIGHT // 2 : -4, 20:-20] = True
    return np.mean((np.abs(found / truth - 1) < 0.01)[here] & (score > LEAST_SCORE)[here])


def test_a_floor_seen_at_an_angle_is_found_by_slanted_windows():
    assert found_of(0) < 0.35
    assert found_of(3) > 0.75


def test_threads_make_no_difference():
    image, others, to, truth = floor()
    plain = [np.ascontiguousarray(a, np.float32) for a in (image, np.stack(others), to)]
    results = []
    for threads in (1, 3):
        planes, score = np.zeros((3, *truth.shape), np.float32), np.empty_like(truth)
        planes[0] = 0.4
        _kernels.patch_match(*plain, AGREEING, (1e-3, 1.0), 0.02, FOCAL, 2, None, planes, score, threads)
        results.append((planes, score))
    assert np.array_equal(results[0][0], results[1][0]) and np.array_equal(results[0][1], results[1][1])


def test_only_what_is_wanted_changes():
    image, others, to, truth = floor()
    wanted = np.zeros(truth.shape, bool)
    wanted[60:70, 40:80] = True
    rough = np.full_like(truth, 0.5)
    found, score = refine(image, others, to, AGREEING, rough, (1e-3, 1.0), 40, FOCAL, 1, wanted)
    assert (found[~wanted] == 0.5).all() and (score[~wanted] == -1).all()
    assert (found[wanted] != 0.5).mean() > 0.5 and score[wanted].min() > -1


def test_what_does_not_fit_is_refused():
    image = np.zeros((4, 5), np.float32)
    others, to = np.zeros((2, 4, 5), np.float32), np.zeros((2, 3, 4), np.float32)
    planes, score = np.zeros((3, 4, 5), np.float32), image.copy()
    rest = ((0.1, 1.0), 0.1, 5.0, 1, None)
    for bad, message in (
        ((image[:1].copy(), others, to, 2, *rest, planes, score), r"image must be \[H,W\]"),
        ((image, np.zeros((9, 4, 5), np.float32), to, 2, *rest, planes, score), "1 to 8 images"),
        ((image, others, to[:1].copy(), 2, *rest, planes, score), r"to must be \[2,3,4\]"),
        ((image, others, to, 0, *rest, planes, score), "best must be at least 1"),
        ((image, others, to, 2, *rest[:-1], np.ones((4, 4), bool), planes, score), r"wanted must be \[H,W\]"),
    ):
        with pytest.raises(ValueError, match=message):
            _kernels.patch_match(*bad, 1)
    _kernels.patch_match(image, others, to, 2, *rest, planes, score, 1)
    assert (score == -1).all()  # nothing to compare
