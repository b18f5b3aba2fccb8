"""Seeds on moving objects at several times, with positions and velocities from masks and flow.

If several cameras see the same time, seeds lie where they agree on the depth of what their masks show, and for the rest on the visual hull
of the masks. For one moving camera they lie on the pixels of its mask, at the depth that `depths.py` finds. Velocities are measured over
neighbouring frames.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import torch

from ...scene.seeds.colours import median_colours
from ...scene.seeds.moving.at_rest import StaticScene
from ...scene.seeds.moving.hull import VisualHull
from ...scene.seeds.moving.moving_seeds import MovingSeeds
from ...scene.seeds.moving.surfaces import surface_points
from ...scene.views import Views
from ...vision.flow.chain import Chain
from ...vision.moving.followed_parts import Objects, follow_objects
from ...vision.sequences import camera_sequences
from ..depth.artifact import StoredDepth
from ..flow.artifact import StoredFlow
from .depths import depth_at, object_depths, steady
from .held import held_map
from .key_times import APART_ALONE, KEYS, PAIRS, SLOWER, WAY_ALONE, apart_by_speed, key_times
from .scene_flow import next_positions, places_of

FEWEST_FRAMES = 3  # least number of frames of a camera for a path
FEWEST_CAMERAS = 2  # least number of cameras that see a time for a hull
HULL = 20_000  # points of a visual hull
AT_ONCE = 4  # times of a rig whose seeds are placed at once, which bounds the memory
MEASURED_SHARE = 0.6  # of the seeds at a time, where cameras agree on their depth
STEP = 4  # px, between the pixels of a mask whose speed is measured
AROUND = 3  # frames on either side over which the velocity is measured for one camera


def rig_seeds(
    flow: StoredFlow,
    views: Views,
    mask: Callable[[int], np.ndarray | None],
    rows: np.ndarray,
    most: int,
    seed: int,
    advance: Callable[[int], None] = lambda n: None,
) -> MovingSeeds | None:
    """Up to ``most`` seeds on what the masks show at key times; None if no seed is found or fewer than two cameras have masks.

    mask(i): [H, W] bool, moving pixels of frame i, or None. rows: indices of the key times among the training times. advance: called with
    the number of key times that are done.
    """
    times = np.unique(views.time[views.train])
    sequences = [f for f in camera_sequences(views.camera, views.time, views.train).values() if len(f) == len(times)]
    chains = [(Chain(flow, frames), frames) for frames in sequences]
    hull = VisualHull(views)

    def at(k: int) -> MovingSeeds | None:
        frames = views.train[views.time[views.train] == times[k]]
        known = [(i, m) for i in frames if (m := mask(int(i))) is not None]
        advance(1)
        if len(known) < FEWEST_CAMERAS:
            return None
        chosen, masks = np.array([i for i, _ in known]), [m for _, m in known]
        points, colors = on_surfaces(views, hull, masks, chosen, most // len(rows), seed)
        if not len(points):
            return None
        alive = np.ones(len(points), bool)
        steps = [(d, next_positions(views, chains, k, d, points, alive)) for d in (1, -1) if 0 <= k + d < len(times) and len(chains) > 1]
        known_steps = np.stack([there for _, (_, there) in steps]) if steps else np.zeros((1, len(points)), bool)
        moved = np.stack([d * (to - points) for d, (to, _) in steps]) if steps else np.zeros((1, len(points), 3))
        velocity = (moved * known_steps[..., None]).sum(0) / np.maximum(known_steps.sum(0), 1)[:, None]
        return MovingSeeds(points, colors, velocity * per_frame(views, times, k), np.full(len(points), times[k]))

    # Beside one another, since a part of the work on one time is done by one thread.
    with ThreadPoolExecutor(min(torch.get_num_threads(), AT_ONCE)) as pool:
        return join([found for found in pool.map(at, rows) if found is not None])


def on_surfaces(
    views: Views, visual_hull: VisualHull, masks: list[np.ndarray], frames: np.ndarray, most: int, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """Up to ``most`` points [n, 3] (world units) on what the ``masks`` of ``frames`` of one time show, and colours [n, 3] in [0, 1]: where
    cameras agree on its depth, and for the rest on the visual hull."""
    hull = visual_hull.points(masks, frames, HULL, seed)
    if not len(hull):
        return hull, np.zeros((0, 3))
    measured, measured_colors, left = surface_points(views, frames.tolist(), [views.load(int(i)) for i in frames], masks, hull)
    rng = np.random.default_rng(seed)
    measured_chosen = rng.permutation(len(measured))[: int(MEASURED_SHARE * most)]
    hull = hull[left]
    hull = hull[rng.permutation(len(hull))[: most - len(measured_chosen)]]
    points, colors = measured[measured_chosen], measured_colors[measured_chosen]
    return np.concatenate([points, hull]), np.concatenate([colors, median_colours(views, hull, frames, masks)[0]])


def camera_seeds(
    flow: StoredFlow,
    views: Views,
    static: np.ndarray,
    at_once: int,
    most: int,
    advance: Callable[[int], None] = lambda n: None,
    given: StoredDepth | None = None,
    rest: StaticScene | None = None,
) -> MovingSeeds | None:
    """Seeds on the masks of moving cameras at key times; None if masks are empty or nothing determines a depth. They are up to ``at_once``
    for each of these times, or as many as that makes for `KEYS` times if there are fewer, but all together not more than ``most``.

    static [P, 3]: points that are mostly static. given: depth of the capture. rest: what shows it gets no seeds. advance: called with the
    number of frames that are done.
    """
    found, held = [], dict[int, np.ndarray]()
    cameras = [f for f in camera_sequences(views.camera, views.time, views.train).values() if len(f) >= FEWEST_FRAMES]
    for frames in cameras:
        chain = Chain(flow, frames)
        depth = None if given is None else {k: given.z[i] for k, i in enumerate(frames) if i in given.z}
        objects = follow_objects(chain, len(frames), depth)
        depths = object_depths(objects, views, frames, static, given)
        advance(len(frames))
        known = [float(np.median(values[values > 0])) for values in depths if (values > 0).any()]
        if not known:
            continue
        usual = float(np.median(known))
        if given is not None:
            for k, i in enumerate(frames):
                if i in given.z:
                    held[i] = held_map(objects, depths[k], views.K[i], k, usual, given, i)
                    if rest is not None:
                        held[i] *= without(np.ones(held[i].shape[1:], bool), rest.shown(i))
        speed = own_speed(chain, objects, depths, views, frames, usual)
        rows = key_times(views.time[frames], apart_by_speed(APART_ALONE, WAY_ALONE, speed))
        area = sum(int(chain.mask(k).sum()) for k in rows)
        count = min(at_once * max(KEYS, len(rows)), most)
        stride = max(1, int(np.ceil(np.sqrt(area * len(cameras) / max(count, 1)))))
        for k in rows:
            begin = pixels(chain.mask(k) if rest is None else without(chain.mask(k), rest.shown(frames[k])), stride)
            if not len(begin):
                continue
            places, alive = chain.follow(k, begin, AROUND)
            near = [j for j in range(k - AROUND, k + AROUND + 1) if 0 <= j < len(frames)]
            z = np.zeros(alive.shape, np.float32)
            for j in near:
                z[j] = depth_at(objects, depths[j], views.K[frames[j]], j, places[j], usual, given, frames[j])
            z = steady(z, alive)
            where = np.stack([views.lift(frames[j], places[j] + 0.5, z[j]).astype(np.float32) for j in near])
            number = views.time[[frames[j] for j in near]] * (len(np.unique(views.time)) - 1)
            velocity = slope(number, where, alive[near])
            picture = views.load(frames[k]) / 255.0
            color = picture[begin[:, 1].astype(int), begin[:, 0].astype(int)]
            time = np.full(len(begin), views.time[frames[k]])
            found.append(MovingSeeds(where[near.index(k)].astype(np.float64), color, velocity, time))
    seeds = join(found)
    return None if seeds is None else seeds._replace(held=held)


def pixels(mask: np.ndarray, stride: int) -> np.ndarray:
    """Those of ``mask`` [H, W] bool on a grid of ``stride`` px: x and y, [n, 2] float32."""
    y, x = np.nonzero(mask[stride // 2 :: stride, stride // 2 :: stride])
    return (np.stack([x, y], 1) * stride + stride // 2).astype(np.float32)


def without(mask: np.ndarray, others: np.ndarray) -> np.ndarray:
    """``mask`` [H, W] bool without the pixels ``others`` [h, w] bool, of another size."""
    size = mask.shape[1], mask.shape[0]
    return np.asarray(mask & (cv2.resize(others.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) == 0))


def own_speed(chain: Chain, objects: Objects, depths: list[np.ndarray], views: Views, frames: list[int], usual: float) -> float:
    """How far what moves gets between neighbouring ``frames`` of one camera, in widths of the image, compared with where the camera's own
    motion would take it: `SLOWER` percent of its pixels are slower. 0 if nothing moves. For the rest, see `depth_at`."""
    found = []
    for k in range(0, len(frames) - 1, max(1, len(frames) // PAIRS)):
        begin = pixels(chain.mask(k), STEP)
        moved = chain.move(k, 1, begin)
        if moved is None or not len(begin):
            continue
        z = depth_at(objects, depths[k], views.K[frames[k]], k, begin, usual)
        at_rest = places_of(views, frames[k + 1], views.lift(frames[k], begin + 0.5, z).astype(np.float32))
        there, trusted = moved
        found.append(np.linalg.norm(there - at_rest, axis=1)[trusted & np.isfinite(at_rest).all(1)])
    values = np.concatenate(found) if found else np.zeros(0)
    return float(np.percentile(values, SLOWER)) / chain.width if len(values) else 0.0


def slope(x: np.ndarray, y: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Least-squares slope [N, 3] of ``y`` [K, N, 3] over ``x`` [K], using only ``known`` [K, N] values; 0 if fewer than two are known."""
    weight = known[..., None].astype(np.float64)
    count = np.maximum(weight.sum(0), 1)
    dx = x[:, None, None] - (weight * x[:, None, None]).sum(0) / count
    dy = y - (weight * y).sum(0) / count
    spread = (weight * dx * dx).sum(0)
    return (weight * dx * dy).sum(0) / np.where(spread > 0, spread, 1.0)


def per_frame(views: Views, times: np.ndarray, k: int) -> float:
    """Factor from world units per step between training times around index ``k`` to world units per frame of the capture."""
    low, high = max(k - 1, 0), min(k + 1, len(times) - 1)
    frames = (times[high] - times[low]) * (len(np.unique(views.time)) - 1)
    return (high - low) / frames if frames > 0 else 1.0


def join(found: list[MovingSeeds]) -> MovingSeeds | None:
    if not found:
        return None
    points, colors, velocities, time = (np.concatenate(parts) for parts in zip(*(one[:4] for one in found)))
    return MovingSeeds(points, colors, velocities, time)
