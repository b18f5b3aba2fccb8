"""The motions of a model as arrays of the web player: lives as they are, nodes as a few courses, planes as paths."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from torch import Tensor

    from ...scene.model import Model
    from ...scene.motion.nodes.control_nodes import ControlNodes

Kept = tuple[Any, tuple[int, int]]  # indices, still ones first; how many are still and how many move
MOST_KEYS = 1025
MOMENTS = 3  # between two keys, at which the motion is compared with what follows from the keys
LIFE = np.array([0.02, 0.02])  # steps of the middle (frames) and ln of the span
SPIN = 0.01  # rad
WEIGHT = np.array([3 / 4, 1 / 2, 1 / 3]) / 255  # the largest comes first, so that these are their ranges
PATH_TURN, PATH_SCALE = 0.002, 0.02
OFTEN = 1, 2, 4, 8, 16, 32, 64  # keys of nodes for each time of the capture
PATHS_OFTEN = 1, 2, 4  # keys of paths, which every primitive has
LOOKED_AT = 1000  # points by which the number of keys is chosen
MOST_NUMBERS = 10**8  # of all paths together; longer clips of larger scenes get fewer keys


def numbers(tensor: Tensor) -> np.ndarray:
    """float64."""
    return tensor.detach().cpu().double().numpy()


@dataclass
class Moved:
    """Fields of the header, arrays and steps that say how a model moves."""

    header: dict[str, Any]
    arrays: dict[str, np.ndarray] = field(default_factory=dict)
    steps: dict[str, Any] = field(default_factory=dict)


def motion_arrays(model: Model, gaussians: Kept, convexes: Kept, axes: np.ndarray | None, times: int, step: float) -> Moved:
    """How the ``gaussians`` and ``convexes`` of ``model`` move. axes: see `gaussian_shapes`. step: of positions, world units."""
    header = {"motion": "static", "keys": 0, "nodes": 0, "modes": 0, "light": False}
    moves = gaussians[1][1] + convexes[1][1] > 0
    motion: Any = model.motion
    if motion.played_as == "lives" and moves:
        return lives(model, {"g": gaussians, "c": convexes}, header | {"motion": "lives", "frames": motion.times}, step)
    if motion.played_as == "nodes":  # whose light may change even if nothing moves
        return on_nodes(model, motion, {"g": gaussians, "c": convexes}, header | {"motion": "nodes"}, times, step)
    if motion.played_as == "paths" and moves:
        assert axes is not None
        return paths(model, gaussians, convexes, axes, header | {"motion": "paths"}, times, step)
    return Moved(header)


def lives(model: Model, kinds: dict[str, Kept], header: dict[str, Any], step: float) -> Moved:
    import torch

    from ...scene.formats.web.moved import reach_of
    from ...scene.motion.lifetimes.lifetime import lifetime

    moved = Moved(header)
    for kind, (index, (still, _)) in kinds.items():
        life = lifetime((model.gaussians if kind == "g" else model.convexes).select(index[still:]))
        spans = np.rint(numbers(life.log_spans) / LIFE[1]) * LIFE[1]
        reach = numbers(reach_of(torch.tensor(spans, dtype=torch.float32), header["frames"]))[:, None]
        moved.arrays[f"{kind}_life"] = np.stack([numbers(life.times), spans], 1)
        moved.arrays[f"{kind}_drift"] = numbers(life.velocities) * reach
        moved.arrays[f"{kind}_spin"] = numbers(life.spins) * reach
        moved.steps |= {f"{kind}_life": LIFE, f"{kind}_drift": step, f"{kind}_spin": SPIN}
    return moved


def on_nodes(model: Model, nodes: ControlNodes, kinds: dict[str, Kept], header: dict[str, Any], times: int, step: float) -> Moved:
    import torch

    from ...scene.formats.web.layout import LINKS

    resting = nodes._with_rigid_parts(nodes._resting(), 0.0)
    radius = float((0.5 / resting.falloff).sqrt().median()) * 2
    scale = np.array([radius] * 4 + [1.0] * 3)  # a turn moves what is a radius away

    def poses(moments: np.ndarray) -> np.ndarray:
        """[T, B, 7] turns, each on the side of the one before, and shifts."""
        found = [numbers(p) for p in nodes._poses([float(t) for t in moments])]
        parts = rigid_poses(nodes, moments)
        turns, shifts = (np.concatenate(pair, 1) for pair in zip(found, parts))
        sides = np.sign((turns[1:] * turns[:-1]).sum(2, keepdims=True))
        turns[1:] *= np.where(sides == 0, 1, sides).cumprod(0)
        return np.concatenate([turns - [1, 0, 0, 0], shifts], 2)

    pose = sampled(poses, times, step, scale)
    keys, count = pose.shape[:2]
    left, size, right = np.linalg.svd((pose * scale).reshape(keys, -1), full_matrices=False)
    least, modes = 0, len(size)  # too few, and enough
    while modes - least > 1:
        half = (least + modes) // 2
        enough = np.abs((left[:, half:] * size[half:]) @ right[half:]).max() <= step / 2
        least, modes = (least, half) if enough else (half, modes)
    strength = np.abs(left[:, :modes]).max(0)
    courses = left[:, :modes] / strength
    shapes = (right[:modes] * (size[:modes] * strength)[:, None]).reshape(modes, count, 7) / scale
    header |= {"keys": keys, "nodes": count, "modes": modes, "light": True}
    moved = Moved(header, {"node_homes": numbers(resting.home)[:, None], "node_modes": shapes, "node_courses": courses[:, None]})
    moved.steps |= {"node_homes": step, "node_modes": step / 4 / scale}
    moved.arrays["light"] = numbers(nodes.light._at([float(t) for t in np.linspace(0, 1, keys)])[0])[:, None]
    for kind, (index, (still, _)) in kinds.items():
        primitives = (model.gaussians if kind == "g" else model.convexes).select(index[still:])
        points = primitives.rest_points().detach()
        each = len(points) // max(len(primitives), 1)
        hyper = primitives.hyper.detach().repeat_interleave(each, 0)
        link = nodes.links(primitives).long() if len(points) else torch.zeros(0, 1, dtype=torch.int64)
        apart = (points[:, None] - resting.home[link]).square().sum(2) + (hyper[:, None] - resting.home_hyper[link]).square().sum(2)
        weights = torch.softmax(-apart * resting.falloff[link], 1)
        missing = LINKS - link.shape[1]
        padded = np.pad(numbers(weights), ((0, 0), (0, missing)))[:, : LINKS - 1]
        shape = (len(primitives), each if kind == "c" and each else (1 if kind == "g" else model.convexes.points.shape[1]))
        moved.arrays[f"{kind}_links"] = np.pad(numbers(link), ((0, 0), (0, missing)), mode="edge").reshape(*shape, LINKS)
        moved.arrays[f"{kind}_weights"] = padded.reshape(*shape, LINKS - 1)
        moved.steps[f"{kind}_weights"] = WEIGHT
    if not np.abs(moved.arrays["light"]).max() > 1e-6:
        header["light"] = False
        del moved.arrays["light"]
    return moved


def rigid_poses(nodes: ControlNodes, moments: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit turns [T, b, 4] and shifts [T, b, 3] of the rigid parts at all ``moments``, as `RigidParts.pose` gives them for one."""
    parts = nodes.rigid_parts
    keys = [numbers(p) for p in (parts.quats, parts.shifts)]
    place = moments * (len(keys[0]) - 1)
    low = np.minimum(place.astype(int), max(len(keys[0]) - 2, 0))
    high, share = np.minimum(low + 1, len(keys[0]) - 1), (place - low)[:, None, None]
    turns, shifts = (one[low] * (1 - share) + one[high] * share for one in keys)
    return turns / np.maximum(np.linalg.norm(turns, axis=2, keepdims=True), 1e-6), shifts


def sampled(of: Any, times: int, step: float, scale: np.ndarray, choices: tuple[int, ...] = OFTEN) -> np.ndarray:
    """``of`` [T] moments -> [T, B, c] at evenly spaced keys. There are as few of ``choices`` for each time of the capture as keep what
    lies between two keys on a straight line within ``step`` of the truth; ``scale`` [c]: what a unit of each number moves, world units."""
    spans = max(times - 1, 1)
    for often in choices:
        keys = spans * often + 1
        at = of(np.linspace(0, 1, (keys - 1) * MOMENTS + 1))
        chosen = at[::MOMENTS]
        error = max(
            float(np.abs((chosen[:-1] + (chosen[1:] - chosen[:-1]) * (m / MOMENTS) - at[m::MOMENTS]) * scale).max())
            for m in range(1, MOMENTS)
        )
        if error <= step or spans * often * 2 + 1 > MOST_KEYS:
            break
    return chosen


def paths(model: Model, gaussians: Kept, convexes: Kept, axes: np.ndarray, header: dict[str, Any], times: int, step: float) -> Moved:
    motion, (index, (still, moving)), (bent, (stiff, bending)) = model.motion, gaussians, convexes
    which, corners = index[still:], bent[stiff:]
    rest = motion.rest(model, which, corners)  # type: ignore[operator]
    each = model.convexes.points.shape[1]
    own = axes[still:]

    def at(moments: np.ndarray, points: Tensor = rest.points) -> np.ndarray:
        """[T, points, 10] shifts of ``points``, and the turns and growth of what is there."""
        found = []
        for t in moments:
            shift, turn, growth = (numbers(p) for p in motion(points, float(t)))
            found.append(np.concatenate([shift, turn * np.sign(turn[:, :1] + 1e-12), growth], 1))
        return np.stack(found)

    size = float(np.median(numbers(model.gaussians.log_scales.exp().amax(1)))) if len(model.gaussians) else step
    scale = np.array([1.0] * 3 + [0.3 * size] * 4 + [0.3 * size] * 3)
    some = rest.points[:: max(1, len(rest.points) // LOOKED_AT)]
    keys = len(sampled(lambda moments: at(moments, some), times, 4 * step, scale, PATHS_OFTEN))
    keys = min(keys, max(2, MOST_NUMBERS // (10 * len(rest.points))))
    found = at(np.linspace(0, 1, keys))
    growth = np.take_along_axis(found[:, :moving, 7:], np.broadcast_to(own, (keys, moving, 3)), 2)
    header |= {"keys": keys}
    moved = Moved(header, {"g_path_means": found[:, :moving, :3], "g_path_turns": found[:, :moving, 3:7], "g_path_scales": growth})
    moved.arrays["c_path_points"] = found[:, moving:, :3].reshape(keys, bending * each, 3)
    moved.steps |= {"g_path_means": step, "g_path_turns": PATH_TURN, "g_path_scales": PATH_SCALE, "c_path_points": step}
    return moved
