"""Decides whether anything but the camera moves, from sampled pictures and before structure from motion. A scene counts as static only on
positive evidence."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np

from ...pipeline.choice.evenly import evenly
from ..flow.method import MINIMUM_SIDE
from ..flow.two_way import consistency, dis_flow
from ..images.pictures import shrunk
from ..sequences import camera_sequences
from .motion_mask import MotionMask
from .moving_masks import frame_evidence, moving_mask
from .residual import Neighbour
from .static_matches import Features, PairEvidence, compare, features
from .two_view import TwoView

SIZE = 480  # px, longest side at which features are compared
DENSE_SIZE = 320  # px, longest side for flow and for fixed cameras
CAMERAS = 12  # the most fixed cameras that are examined
TIMES = 16  # frames examined of each
ALL = 12  # pictures; up to this many all take part, otherwise each of ANCHORS is compared with one later picture
ANCHORS = 8
STEPS = (8, 4, 2, 1)  # pictures ahead, tried in this order until one has enough in common
LINKED = 60  # distinctive matches that obey one camera motion: ten times what repeated structures reach by chance
FOLLOWED = 0.6  # share of the picture whose flow must be consistent for the flow to be trusted
TRAVEL = 0.01  # of the width, about how far the flow of the compared pictures should reach
FARTHEST = 0.03  # of the width; between photos farther apart, flow mistakes the parallax of near against far things for motion
LOST = 1e6  # of the width; no flow is this long
SHARE = 0.001  # of a picture; if more of it moves, by its own measured flow, the scene moves
CHANGED = 1e-4  # of a fixed camera's picture; sensor and codec noise stay below this
PLAIN = 4.0  # grey levels; pictures with a smaller standard deviation show nothing
Picture = Callable[[int], np.ndarray]


@dataclass(frozen=True)
class Verdict:
    """static: nothing moves, on positive evidence. largest_moving_share: the largest share of a picture (or of its features) found to move.

    reason: one sentence for people. evidence: the numbers behind it, plain JSON values.
    """

    static: bool
    largest_moving_share: float
    reason: str
    evidence: Mapping[str, float | int | str] = field(default_factory=dict)


def static_scene(
    picture: Picture,
    camera: np.ndarray,
    time: np.ndarray,
    fixed_cameras: bool,
    K: np.ndarray | None = None,
    cam_from_world: np.ndarray | None = None,
    untimed: bool = False,
) -> Verdict:
    """Decide for the frames of a capture; picture(i) gives uint8 [H, W, 3] of frame i, from any thread.

    camera [F] int and time [F] as in the `frames` artifact without `--static`. fixed_cameras: several cameras that do not move.
    untimed: neighbours in the list need not be neighbours in time, as with photos. Then flow between pictures that are far apart is
    ignored, and so are features that contradict the camera motion if too few agree with it.
    K [F, 3, 3] px and cam_from_world [F, 4, 4], if known: features must then obey the poses, not just some camera motion.

    Fixed cameras: no pixel may change (`MotionMask`). Others: distinctive features must obey one camera motion, pair by pair, over wide
    baselines (`static_matches`). If dense flow between neighbouring pictures is reliable, no region may move against that motion either
    (`objects`). Every sampled picture must be linked to another; otherwise there is no evidence. Motion between the sampled frames, or
    without texture over a wide baseline, is not seen. Deterministic; about 40 pictures of a moving camera are read.
    """
    camera, time = np.asarray(camera), np.asarray(time)
    if len(camera) < 2:
        return Verdict(False, 0.0, "a single picture does not show what moves", {"pictures": len(camera)})
    order = sorted(range(len(camera)), key=lambda i: (float(time[i]), int(camera[i]), i))
    by_camera = list(camera_sequences(camera, time).values())
    if fixed_cameras:
        return _fixed(picture, [mine for mine in by_camera if len(mine) > 1])
    return _moving(picture, order, by_camera, K, cam_from_world, untimed)


def _fixed(picture: Picture, cameras: Sequence[Sequence[int]]) -> Verdict:
    """Decides for fixed cameras, by the share of each camera's pixels that ever change."""
    if not cameras:
        return Verdict(False, 0.0, "no camera saw two times", {})
    chosen = evenly(cameras, CAMERAS)

    def changed(mine: Sequence[int]) -> tuple[float, float, int]:
        frames = [shrunk(picture(i), DENSE_SIZE) for i in evenly(mine, TIMES)]
        mask = MotionMask(frames)
        for frame in frames:
            mask.add(frame)
        return float((mask.mask(0) > 0).mean()), float(np.std(frames[0])), len(frames)

    with ThreadPoolExecutor(2) as pool:
        results = list(pool.map(changed, chosen))
    share, texture = max(r[0] for r in results), min(r[1] for r in results)
    numbers: dict[str, float | int | str] = {"cameras": len(results), "pictures": sum(r[2] for r in results), "changed": round(share, 6)}
    if share > CHANGED:
        return Verdict(False, share, f"up to {100 * share:.2g} % of a fixed camera's pixels change", numbers)
    if texture < PLAIN:
        return Verdict(False, share, "a camera's pictures are plain, so that motion could not show", numbers)
    return Verdict(True, share, f"no pixel of {len(results)} fixed cameras changes over {results[0][2]} times", numbers)


def _moving(
    picture: Picture,
    order: Sequence[int],
    by_camera: Sequence[Sequence[int]],
    K: np.ndarray | None,
    poses: np.ndarray | None,
    untimed: bool,
) -> Verdict:
    share, flows = _dense(picture, max(by_camera, key=len), untimed)
    numbers: dict[str, float | int | str] = {"flow_frames": flows, "flow_share": round(share, 6)}
    if share > SHARE:
        return Verdict(False, share, f"flow shows {100 * share:.2g} % of a picture moving against the camera's motion", numbers)
    links = _sparse(picture, order, K, poses, untimed)
    supporting, moving = sum(p.supporting for p in links), sum(p.moving for p in links)
    unlinked = sum(p.supporting < LINKED for p in links)
    numbers |= {"pairs": len(links), "unlinked": unlinked, "supporting": supporting, "moving": moving}
    numbers["displacement"] = round(float(np.median([p.displacement for p in links])), 1) if links else 0.0
    share = max(share, moving / max(1, moving + supporting))
    if moving:
        return Verdict(False, share, f"{moving} distinctive features move together against the camera's motion", numbers)
    if unlinked or not links:
        return Verdict(False, share, f"{unlinked} of {len(links)} sampled pictures show too little in common to tell", numbers)
    words = f"all {supporting} features of {len(links)} pairs of pictures obey the camera's motion"
    return Verdict(True, share, words + (f", and so does the flow of {flows} frames" if flows else ""), numbers)


def _sparse(picture: Picture, order: Sequence[int], K: np.ndarray | None, poses: np.ndarray | None, untimed: bool) -> list[PairEvidence]:
    """For each sampled picture, the evidence of its link to a later one; with few pictures also of the link two pictures ahead."""
    count = len(order)
    every = count <= ALL
    starts = range(count - 1) if every else np.linspace(0, count - 1 - STEPS[0], ANCHORS).round().astype(int).tolist()
    kept: dict[int, Features] = {}
    size = 1.0

    def of(position: int) -> Features:
        if position not in kept:
            kept[position] = features(shrunk(picture(order[position]), SIZE))
        return kept[position]

    def link(a: int, b: int) -> PairEvidence:
        return compare(of(a), of(b), size, _geometry(K, poses, order[a], order[b], factor))

    height, width = picture(order[0]).shape[:2]
    factor = min(1.0, SIZE / max(height, width))
    size = factor * max(height, width)

    def from_start(a: int) -> list[PairEvidence]:
        best = PairEvidence(-1, 0, 0.0)
        for step in (1, 2, 3) if every else STEPS:
            if a + step < count:
                found = link(a, a + step)
                best = max(best, found, key=lambda p: p.supporting)
                if found.moving and not untimed:
                    return [found]
                if found.supporting >= LINKED:
                    break
        extra = [link(a, a + 2)] if every and a + 2 < count else []
        return [best, *(p for p in extra if p.supporting >= LINKED)]

    with ThreadPoolExecutor(2) as pool:
        if every:
            list(pool.map(of, range(count)))
        return [p for found in pool.map(from_start, starts) for p in found]


def _geometry(K: np.ndarray | None, poses: np.ndarray | None, a: int, b: int, factor: float) -> TwoView | None:
    """Two-view geometry from poses, at `factor` times the size; the rotation's homography if there is no baseline."""
    if K is None or poses is None or not np.isfinite([*K[[a, b]].ravel(), *poses[[a, b]].ravel()]).all():
        return None
    from ..sfm.epipolar import fundamental

    scale = np.diag([factor, factor, 1.0])
    first, second = scale @ K[a], scale @ K[b]
    relative = poses[b] @ np.linalg.inv(poses[a])
    if np.linalg.norm(relative[:3, 3]) <= 1e-9 * max(1.0, float(np.linalg.norm(poses[a][:3, 3]))):
        return TwoView("homography", second @ relative[:3, :3] @ np.linalg.inv(first))
    return TwoView("epipolar", fundamental(first, second, poses[a], poses[b]))


def _dense(picture: Picture, mine: Sequence[int], untimed: bool) -> tuple[float, int]:
    """Largest share of a picture that moves according to flow, and how many frames of this camera had reliable flow."""
    farthest = FARTHEST if untimed else LOST
    middles = sorted(set(np.linspace(1, len(mine) - 2, ANCHORS).round().astype(int).tolist())) if len(mine) >= 3 else []

    def share(k: int) -> float | None:
        image = shrunk(picture(mine[k]), DENSE_SIZE)
        if min(image.shape[:2]) < MINIMUM_SIDE:
            return None
        flow, sure = _flow(image, shrunk(picture(mine[k + 1]), DENSE_SIZE))
        travel = _travel(flow, sure)
        if travel > farthest:
            return None
        step = int(np.clip(round(TRAVEL / max(travel, 1e-5)), 1, STEPS[0]))
        around = [_flow(image, shrunk(picture(mine[j]), DENSE_SIZE)) for j in (k - step, k + step) if 0 <= j < len(mine)]
        followed = [Neighbour(*one) for one in around if _travel(*one) <= farthest]
        if untimed and len(followed) < 2:  # a single pair of photos shows flow errors as often as motion
            return None
        found = frame_evidence(followed or [Neighbour(flow, sure)])
        # pixels that the mask filled in from their surroundings are a good guess for a mask, but not evidence
        return float(((moving_mask(image, found) > 0) & (found.weight > 0.5) & (found.score > 0)).mean())

    with ThreadPoolExecutor(2) as pool:
        found = [s for s in pool.map(share, middles) if s is not None]
    return max(found, default=0.0), len(found)


def _travel(flow: np.ndarray, sure: np.ndarray) -> float:
    """Median length of a flow as a share of the picture's width; infinite if too little of it is consistent to be trusted."""
    followed = sure >= 128
    if followed.mean() < FOLLOWED:
        return np.inf
    return float(np.median(np.hypot(*np.moveaxis(flow[followed], -1, 0)))) / flow.shape[1]


def _flow(first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    forward, backward = dis_flow(first, second, "fast"), dis_flow(second, first, "fast")
    return forward, consistency(forward, backward)
