"""A mask per frame of the pixels that show something moving in the world: flow minus camera motion."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache

import numpy as np

from ..flow.two_way import FlowPair, consistency
from ..warp import places, warped
from .evidence import Evidence, evidence, spread_of_flow
from .residual import Neighbour, rigid_residual
from .uncalibrated import uncalibrated_residual

GAPS = (1, 2, 4)  # frames to either side; slow motion adds up over the longer ones, fast motion is matched over the shorter
NEXT_TO = 0.5  # weight of the evidence from the frames before and after
SMOOTHNESS = 0.0013  # of the picture's width squared; evidence spreads over about a tenth of the width if no edge is in the way
EDGE = 8.0  # grey levels; a step of a few times this stops the spread of evidence
LEAST = 1e-3  # weight of pixels without evidence; their neighbours decide
SPECK = 5e-4  # share of the picture; smaller connected masks are noise that passed the threshold
HOLE = 2e-3  # share of the picture; smaller holes in a mask are filled


def frame_evidence(neighbours: Sequence[Neighbour], K: np.ndarray | None = None, cam_from_world: np.ndarray | None = None) -> Evidence:
    """Evidence of one frame from its flow to other frames: by `rigid_residual` with its pose, by `uncalibrated_residual` without.

    Neighbours on both sides in time compensate for what is hidden on one side. Raises ValueError if shapes or poses do not fit together.
    """
    posed = K is not None and cam_from_world is not None
    residual = rigid_residual(K, cam_from_world, neighbours) if posed else uncalibrated_residual(neighbours)  # type: ignore[arg-type]
    return evidence(residual, spread_of_flow(neighbours))


def moving_mask(picture: np.ndarray, found: Evidence) -> np.ndarray:
    """Mask uint8 [H, W] of one frame, 255 = moving, from its picture uint8 [H, W, 3] and evidence.

    Evidence spreads to pixels without any (hidden or without texture) and is averaged within regions that no edge of the picture divides.
    This is weighted least squares with edge-aware smoothness, by the fast solver of Min et al. 2014 (in OpenCV). Smoothing evidence times
    weight, and weight in the same way, gives a weighted mean. Specks are removed, small holes filled. Raises ValueError for other shapes.
    """
    import cv2

    if picture.shape != (*found.score.shape, 3) or picture.dtype != np.uint8:
        raise ValueError(f"picture: expected uint8 {[*found.score.shape, 3]}, got {picture.dtype} {list(picture.shape)}")
    if not found.weight.any():
        return np.zeros(found.score.shape, np.uint8)
    weight = np.maximum(found.weight, LEAST).astype(np.float32)
    smoothness = max(1.0, SMOOTHNESS * picture.shape[1] ** 2)
    solver = cv2.ximgproc.createFastGlobalSmootherFilter(np.ascontiguousarray(picture), smoothness, EDGE)
    moves = solver.filter(found.score * weight) > 0  # the weighted mean has the same sign
    return _tidy(moves)


def moving_masks(
    picture: Callable[[int], np.ndarray],
    pairs: Sequence[FlowPair | None],
    K: np.ndarray | None = None,
    cam_from_world: np.ndarray | None = None,
    gaps: Sequence[int] = GAPS,
    only: range | None = None,
) -> Iterator[np.ndarray]:
    """Masks uint8 [H, W] of the frames 0 .. len(pairs) of one camera, or of those in ``only``, in order of time; 255 = moving.

    picture(i): uint8 [H, W, 3]. pairs[i]: flow between frames i and i + 1, None if it was not measured. Any sequence works, also one that
    reads on demand: about `2 * max(gaps)` pairs are held at once. K [F, 3, 3], cam_from_world [F, 4, 4]: poses of the frames, or None.
    Frames whose pose is not finite do not serve as neighbours, and their mask is empty. Flow over longer gaps is chained. The evidence of
    the frames before and after is carried over along the flow, so that masks do not flicker. A mask depends only on the frames within
    `max(gaps) + 1` of its own, so stretches of frames can be computed in parallel.
    """
    count = len(pairs) + 1
    posed = None if K is None or cam_from_world is None else np.isfinite(K).all((1, 2)) & np.isfinite(cam_from_world).all((1, 2))
    reach = max(gaps)

    @lru_cache(maxsize=2 * reach + 2)
    def step(i: int, direction: int) -> tuple[np.ndarray, np.ndarray] | None:
        """Flow and confidence from frame i to the next (1) or the one before (-1)."""
        pair = pairs[i if direction > 0 else i - 1]
        if pair is None:
            return None
        if direction > 0:
            return np.asarray(pair.forward, np.float32), pair.confidence
        forward, backward = np.asarray(pair.forward, np.float32), np.asarray(pair.backward, np.float32)
        return backward, consistency(backward, forward)

    def neighbours(i: int) -> list[Neighbour]:
        found = []
        for direction in (-1, 1):
            chained: tuple[np.ndarray, np.ndarray] | None = None
            for gap in range(1, reach + 1):
                j = i + gap * direction
                link = step(j - direction, direction) if 0 <= j < count else None
                if link is None:
                    break
                chained = link if chained is None else chain(chained, link)
                if gap in gaps and (posed is None or posed[j]):
                    found.append(Neighbour(*chained, *(() if posed is None else (K[j], cam_from_world[j]))))  # type: ignore[index]
        return found

    @lru_cache(maxsize=4)
    def own(i: int) -> Evidence | None:
        around = neighbours(i) if posed is None or posed[i] else []
        if not around:
            return None
        return frame_evidence(around) if posed is None else frame_evidence(around, K[i], cam_from_world[i])  # type: ignore[index]

    for i in only if only is not None else range(count):
        image, mine = picture(i), own(i)
        if mine is None:
            yield np.zeros(image.shape[:2], np.uint8)
            continue
        beside = []
        for direction in (-1, 1):
            link = step(i, direction) if 0 <= i + direction < count else None
            other = own(i + direction) if link is not None else None
            if link is not None and other is not None:
                beside.append((*link, other))
        yield moving_mask(image, steadied(mine, beside))


def steadied(mine: Evidence, beside: Sequence[tuple[np.ndarray, np.ndarray, Evidence]]) -> Evidence:
    """Evidence of a frame, averaged with that of other frames, warped along the flow to them. beside: (flow, confidence, evidence) each."""
    total, weight = mine.score * mine.weight, mine.weight.copy()
    for flow, confidence, other in beside:
        score, other_weight = warped(other.score, flow), warped(other.weight, flow)
        other_weight *= confidence.astype(np.float32) * np.float32(NEXT_TO / 255)
        total += score * other_weight
        weight += other_weight
    return Evidence(total / np.maximum(weight, 1e-6), np.minimum(weight, 1.0), mine.sigma)


def chain(first: tuple[np.ndarray, np.ndarray], second: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Chains (flow [H, W, 2], confidence [H, W]) from a to b and from b to c into one from a to c. Confidence is the lower of the two."""
    flow, confidence = first
    height, width = confidence.shape
    x, y = places(flow)
    inside = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    further = warped(second[1].astype(np.float32), flow)
    return flow + warped(second[0], flow), np.where(inside, np.minimum(confidence, further), 0).astype(np.uint8)


def _tidy(moves: np.ndarray) -> np.ndarray:
    import cv2

    for value, share, connectivity in ((True, SPECK, 8), (False, HOLE, 4)):
        count, labels, stats, _ = cv2.connectedComponentsWithStats((moves == value).astype(np.uint8), connectivity=connectivity)
        small = stats[:, cv2.CC_STAT_AREA] < share * moves.size
        small[0] = False  # label 0 is everything else
        moves = moves ^ small[labels] if count > 1 else moves
    return np.where(moves, 255, 0).astype(np.uint8)
