"""Masks of fixed cameras: a person who does not move is found by the colours that move elsewhere, and noise finds nobody."""

import cv2
import numpy as np
import pytest
from e4dgs.vision.moving.colours import LIMIT, PRIOR, SHARE, colour_odds, odds_at
from e4dgs.vision.moving.fixed_camera import CHANGES, ONCE, SIZE, STATIC, FixedCameraMasks, fixed_camera_masks

WIDTH, HEIGHT, TIMES = 160, 120, 12
SHIRT = (150, 40, 40)


def backdrop(rng: np.random.Generator) -> np.ndarray:
    small = rng.integers(90, 170, (HEIGHT // 8, WIDTH // 8, 1)).astype(np.uint8).repeat(3, 2)
    return cv2.resize(small, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)


def person(k: int) -> np.ndarray:
    """A torso that does not move and an arm that swings above its shoulder."""
    mask = np.zeros((HEIGHT, WIDTH), np.uint8)
    mask[50:110, 60:90] = 255
    angle = np.pi * k / TIMES
    cv2.line(mask, (75, 55), (int(75 + 40 * np.cos(angle)), int(55 - 40 * np.sin(angle))), 255, 12)
    return mask > 0


def capture(extra: tuple[int, int, int, int] | None = None, noise: float = 2.0) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Frames and truths. extra: a static thing of the shirt's colour, as left, top, right, bottom."""
    rng = np.random.default_rng(5)
    behind, frames, truths = backdrop(rng), [], []
    for k in range(TIMES):
        frame, truth = behind.astype(float), person(k)
        if extra is not None:
            frame[extra[1] : extra[3], extra[0] : extra[2]] = SHIRT
        frame[truth] = SHIRT
        frames.append(np.clip(np.rint(frame + rng.normal(0, noise, frame.shape)), 0, 255).astype(np.uint8))
        truths.append(truth)
    return frames, truths


def iou(mask: np.ndarray, truth: np.ndarray) -> float:
    return np.count_nonzero((mask > 0) & truth) / np.count_nonzero((mask > 0) | truth)


def test_a_torso_that_does_not_move_is_found_by_the_colour_of_its_arm() -> None:
    frames, truths = capture()
    difference = FixedCameraMasks(frames)
    static = cv2.erode(np.all(truths, axis=0).astype(np.uint8), np.ones((15, 15), np.uint8)) > 0
    assert static.any()
    assert not any((difference._change.score(frame)[static] > 0).any() for frame in frames)  # a difference to the median says nothing
    found = [iou(mask, truth) for mask, truth in zip(fixed_camera_masks(frames), truths, strict=True)]
    assert min(found) > 0.7 and np.mean(found) > 0.85


def test_a_static_thing_of_the_same_colour_is_left_alone() -> None:
    box = (2, 20, 22, 60)
    frames, truths = capture(box)
    masks = fixed_camera_masks(frames)
    assert not any(mask[box[1] : box[3], box[0] : box[2]].any() for mask in masks)
    assert np.mean([iou(mask, truth) for mask, truth in zip(masks, truths, strict=True)]) > 0.8


@pytest.mark.parametrize("share, kept", [(ONCE - 0.01, False), (ONCE + 0.01, True)])
def test_a_region_needs_a_part_that_changed(share: float, kept: bool) -> None:
    box = (2, 20, 22, 60)
    frames, _ = capture(box)
    model = FixedCameraMasks(frames)
    changed = np.arange(800) < 800 * share
    model._ever[box[1] : box[3], box[0] : box[2]] = changed.reshape(40, 20)
    assert model.moving(frames[6])[40, 12] == (255 if kept else 0)


@pytest.mark.parametrize("noise", [0.0, 4.0, 15.0])
@pytest.mark.parametrize("light", [0.0, 0.05])
def test_a_fixed_camera_that_sees_no_motion_masks_nothing(noise: float, light: float) -> None:
    """Also where bright parts are noisier, and where the lamps flicker."""
    rng = np.random.default_rng(2)
    behind = backdrop(rng) * np.linspace(0.3, 1.4, WIDTH)[:, None]
    frames = []
    for k in range(TIMES):
        frame = behind + light * 100 * np.sin(k) + rng.normal(0, noise, behind.shape) * np.sqrt(behind / 100)
        frames.append(np.clip(np.rint(frame), 0, 255).astype(np.uint8))
    assert not any(mask.any() for mask in fixed_camera_masks(frames))


def test_large_pictures_are_judged_small_and_masked_large() -> None:
    frames, truths = capture()
    factor = 2 * SIZE // WIDTH
    size = (WIDTH * factor + 1, HEIGHT * factor)  # a column more than the reduced pictures cover
    frames = [cv2.resize(frame, size, interpolation=cv2.INTER_NEAREST) for frame in frames[::3]]
    model = FixedCameraMasks(frames)
    assert model._ever.shape == (HEIGHT * factor // 2, WIDTH * factor // 2)
    mask = model.moving(frames[2])
    assert mask.shape == size[::-1] and mask.dtype == np.uint8 and set(np.unique(mask)) == {0, 255}
    assert iou(mask, cv2.resize(truths[6].astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0) > 0.7


def test_one_frame_and_tiny_ones() -> None:
    frames, _ = capture()
    assert not FixedCameraMasks(frames[:1]).moving(frames[0]).any()
    assert not FixedCameraMasks([np.zeros((2, 3, 3), np.uint8)] * 3).moving(np.zeros((2, 3, 3), np.uint8)).any()
    with pytest.raises(ValueError, match="at least one frame"):
        FixedCameraMasks([])
    with pytest.raises(ValueError, match=r"expected uint8 \[120, 160, 3\]"):
        FixedCameraMasks(frames).moving(frames[0][:7])


def test_evidence_adds_change_and_colour() -> None:
    frames, truths = capture(noise=0.0)
    found = FixedCameraMasks(frames).evidence(frames[0])
    arm, wall = truths[0] & ~truths[6], ~np.any(truths, axis=0)
    assert np.median(found.score[arm]) == pytest.approx(CHANGES + LIMIT)
    assert np.median(found.score[wall]) < STATIC and found.score.min() >= STATIC - LIMIT and (found.weight == 1).all()


# --- colours


def picture(counts: dict[tuple[int, int, int], int]) -> np.ndarray:
    return np.array([colour for colour, n in counts.items() for _ in range(n)], np.uint8)[None]


def test_odds_are_those_of_the_two_histograms() -> None:
    red, grey, rare = (200, 0, 0), (100, 100, 100), (0, 0, 200)
    one = picture({red: 800, grey: 9199, rare: 1})
    changed = np.zeros(one.shape[:2], bool)
    changed[0, :400] = changed[0, 800:900] = changed[0, -1] = True  # half of the red, a hundredth of the grey, the rare pixel
    odds = colour_odds([one, one], [changed, changed])
    share, kernel = 501 / 9499, 1 / 8  # of what changes; the part of a colour's pixels that smoothing leaves in its own cell

    def expected(moving: float, static: float, kernel: float) -> float:
        return float(np.clip(np.log((kernel * moving / share + PRIOR) / (kernel * static + PRIOR)), -LIMIT, LIMIT))

    assert share > SHARE
    found = {colour: odds_at(odds, picture({colour: 1}))[0, 0] for colour in (red, grey, rare, (30, 200, 30))}
    assert found[red] == pytest.approx(LIMIT) and expected(800, 800, 0.25 * 0.5) == LIMIT
    assert found[grey] == pytest.approx(expected(200, 2 * 9099, kernel), abs=1e-5) and -LIMIT < found[grey] < 0
    assert found[30, 200, 30] == 0.0  # never seen
    assert 0 < found[rare] <= LIMIT and odds.dtype == np.float32


@pytest.mark.parametrize("part, sign", [(SHARE * 0.9, -1), (SHARE * 1.1, 1)])
def test_a_colour_counts_from_a_share_of_its_pixels_on(part: float, sign: int) -> None:
    """However little changes in all: noise must not make a colour a moving object's."""
    grey, red = (100, 100, 100), (200, 0, 0)
    one = picture({red: 10000, grey: 200000})
    changed = np.zeros(one.shape[:2], bool)
    changed[0, : round(10000 * part / (1 + part))] = True
    assert np.sign(odds_at(colour_odds([one], [changed]), picture({red: 1}))[0, 0]) == sign


def test_nothing_changes_and_everything_does() -> None:
    one = picture({(9, 9, 9): 5000})
    for all_of_it in (False, True):
        odds = colour_odds([one], [np.full(one.shape[:2], all_of_it)])
        assert np.isfinite(odds).all() and abs(odds).max() <= LIMIT
