"""What the second picture hides, against exact truth, and cameras that move without hiding anything."""

import cv2
import numpy as np
import pytest
from e4dgs.vision.flow.method import Dis
from e4dgs.vision.flow.outlines import BETTER, LARGEST, sharpened
from e4dgs.vision.flow.two_way import _arrivals, both_ways, occluded, trusted
from factory import Box, Camera, Cells, Motion, Object, Scene, Sphere, look_at, optical_flow, render, to_uint8
from factory.camera import intrinsics

WIDTH, HEIGHT = 240, 180


def sliding(speed: float = 0.6) -> Scene:
    """A box and a ball that slide before a wall, all of fine texture."""
    wall = Object("wall", Box((6.0, 0.2, 5.0)), Cells(0.35, 1), Motion((0.0, 3.0, 0.0)))
    box = Object("box", Box((0.7, 0.3, 0.6)), Cells(0.2, 2), Motion((-0.7, 0.0, 0.0), (speed, 0.0, 0.1)))
    ball = Object("ball", Sphere(0.6), Cells(0.2, 3), Motion((1.0, -0.5, 0.4), (-0.5 * speed, 0.0, -0.3 * speed)))
    return Scene((wall, box, ball))


def camera(x: float = 0.0, back: float = 0.0) -> Camera:
    eye, ahead = np.array([x, -5.0 - back, 0.2]), np.array([x, -back, 0.0])
    return Camera(intrinsics(WIDTH, HEIGHT, 55.0), look_at(eye, ahead), WIDTH, HEIGHT)


def agreement(found: np.ndarray, truth: np.ndarray) -> tuple[float, float]:
    """Precision and recall."""
    both = float((found & truth).sum())
    return both / max(found.sum(), 1), both / max(truth.sum(), 1)


@pytest.mark.parametrize("back", [0.0, 2.5], ids=["camera slides", "camera moves far back"])
def test_exact_flow_tells_what_is_hidden(back: float) -> None:
    first, second = camera(), camera(0.15, back)
    forward = optical_flow(sliding(), first, 0.0, 0.5, second)
    backward = optical_flow(sliding(), second, 0.5, 0.0, first)
    truth = ~forward.visible
    assert 0.02 < truth.mean() < 0.2
    precision, recall = agreement(occluded(forward.flow.astype(np.float32), backward.flow.astype(np.float32)), truth)
    assert precision > 0.8 and recall > 0.8, (precision, recall)


def test_measured_flow_tells_most_of_it() -> None:
    """DIS is what limits it: it bleeds over outlines by a few pixels, of which sharpening takes back most."""
    first, second = camera(), camera(0.15)
    method = Dis()
    pictures = [to_uint8(render(sliding(), view, time, samples=3).image[..., :3]) for view, time in ((first, 0.0), (second, 0.25))]
    pair = trusted(*both_ways(method, *(method.prepare(picture) for picture in pictures)))
    truth = ~optical_flow(sliding(), first, 0.0, 0.25, second).visible
    found = occluded(pair.forward, pair.backward)
    precision, recall = agreement(found, truth)
    assert precision > 0.6 and recall > 0.9, (precision, recall)
    assert not pair.confidence[found].any() and (pair.confidence[~truth] > 0).mean() > 0.85


@pytest.mark.parametrize("factor", [0.6, 0.9, 1.1, 1.7])
def test_a_picture_that_shrinks_or_grows_hides_nothing_but_what_leaves_it(factor: float) -> None:
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(np.float32)
    from_middle = np.stack([x - (WIDTH - 1) / 2, y - (HEIGHT - 1) / 2], -1)
    found = occluded((factor - 1) * from_middle, (1 / factor - 1) * from_middle)
    half = np.array([WIDTH - 1, HEIGHT - 1]) / 2
    stays = (np.abs(factor * from_middle) <= half).all(-1)
    assert found[~stays].all()
    well_inside = cv2.erode(stays.astype(np.uint8), np.ones((9, 9), np.uint8), borderValue=1).astype(bool)
    assert not found[well_inside].any()


def test_flow_that_is_not_finite_or_far_outside_has_an_answer() -> None:
    forward = np.zeros((6, 9, 2), np.float32)
    backward = np.full((6, 9, 2), np.nan, np.float32)
    backward[0], backward[1] = 1e30, -np.inf
    assert occluded(forward, backward).shape == (6, 9)
    assert occluded(np.full((6, 9, 2), 1e9, np.float32), forward).all() and not occluded(forward[:1, :1], forward[:1, :1]).any()
    assert not occluded(forward, forward).any()


def test_arrivals_are_shared_by_the_four_pixels_around_where_they_land() -> None:
    rng = np.random.default_rng(0)
    flow = rng.uniform(-9, 9, (7, 11, 2)).astype(np.float32)
    flow[0, :4] = [[0, 0], [np.nan, 1], [1e30, 0], [-np.inf, 0]]
    flow[6, 10] = [0.5, 0.25]  # half of it leaves the picture to the right, a quarter below
    expected = np.zeros((7, 11))
    for j in range(7):
        for i in range(11):
            x, y = i + float(flow[j, i, 0]), j + float(flow[j, i, 1])
            if not (np.isfinite(x) and np.isfinite(y)):
                continue
            for to_x in range(11):
                for to_y in range(7):
                    expected[to_y, to_x] += max(0, 1 - abs(x - to_x)) * max(0, 1 - abs(y - to_y))
    np.testing.assert_allclose(_arrivals(flow), expected, atol=1e-5)
    assert np.array_equal(_arrivals(np.zeros((3, 4, 2), np.float32)), np.ones((3, 4)))


# --- flow beside outlines


def passing(speed: int = 6, brighter: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Two pictures of a block of fine texture that moves right before a static wall, its exact flow, and what the second hides."""
    rng = np.random.default_rng(4)
    wall, block = (rng.integers(low, high, (60, 90, 3)).astype(np.uint8) for low, high in ((20, 120), (100, 200)))
    pictures = []
    for left in (30, 30 + speed):
        picture = wall.copy()
        picture[20:40, left : left + 25] = block[20:40, :25]
        pictures.append(picture)
    flow, hidden = np.zeros((60, 90, 2), np.float32), np.zeros((60, 90), bool)
    flow[20:40, 30:55, 0] = speed
    hidden[20:40, 55 : 55 + speed] = True
    return pictures[0], pictures[1] + np.uint8(brighter), flow, hidden


@pytest.mark.parametrize("brighter", [0, 20], ids=["same light", "brighter"])
def test_smeared_flow_is_put_right_at_outlines(brighter: int) -> None:
    first, second, exact, hidden = passing(brighter=brighter)
    smeared = cv2.GaussianBlur(exact, (0, 0), 2.0)
    before, after = (np.linalg.norm(flow - exact, axis=-1)[~hidden] for flow in (smeared, sharpened(smeared, first, second)))
    assert np.mean(before > 0.5) > 0.08 and np.mean(after > 0.5) < 0.5 * np.mean(before > 0.5)


@pytest.mark.parametrize("speed", [2, 3])
def test_a_narrow_hidden_band_is_found_once_the_flow_is_sharp(speed: int) -> None:
    first, second, exact, hidden = passing(speed)
    forward = cv2.GaussianBlur(exact, (0, 0), 2.0)
    there = np.zeros_like(exact)
    there[20:40, 30 + speed : 55 + speed, 0] = -speed
    backward = cv2.GaussianBlur(there, (0, 0), 2.0)
    smeared = agreement(occluded(forward, backward), hidden)
    precision, recall = agreement(occluded(forward, sharpened(backward, second, first)), hidden)
    assert smeared[1] < 0.6 and precision > 0.8 and recall > 0.8, (smeared, precision, recall)


@pytest.mark.parametrize("difference, taken", [(BETTER, False), (BETTER + 1, True), (LARGEST + 50, True)])
def test_another_flow_must_match_clearly_better(difference: int, taken: bool) -> None:
    first, second = (np.full((40, 60, 3), 100, np.uint8) for _ in range(2))
    second[:, 20:30] += np.uint8(difference)  # what the flow of the middle leads to; that of the rest leads to what the first shows
    flow = np.zeros((40, 60, 2), np.float32)
    flow[:, 32:36, 0] = -10.0
    assert (sharpened(flow, first, second)[20, 34, 0] == 0.0) == taken


@pytest.mark.parametrize("size", [(1, 1), (1, 4), (4, 1), (8, 8), (64, 9)])
def test_pictures_of_any_size_and_no_motion_stay(size: tuple[int, int]) -> None:
    rng = np.random.default_rng(1)
    first, second = (rng.integers(0, 256, (*size, 3), dtype=np.uint8) for _ in range(2))
    flow = np.zeros((*size, 2), np.float32)
    assert np.array_equal(sharpened(flow, first, second), flow)
    flow += np.float32(2.5)
    assert np.array_equal(sharpened(flow, first, second), flow)
    wild = rng.normal(0, 1e6, flow.shape).astype(np.float32)
    found = sharpened(wild, first, second)
    assert found.dtype == np.float32 and np.isfinite(found).all() and np.array_equal(found, sharpened(wild, first, second))


def test_pictures_of_another_size_are_named() -> None:
    with pytest.raises(ValueError, match=r"expected \[6, 9, 3\] like the flow"):
        sharpened(np.zeros((6, 9, 2), np.float32), np.zeros((6, 9, 3), np.uint8), np.zeros((6, 8, 3), np.uint8))
