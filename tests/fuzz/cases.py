"""Arguments for `rasterize` from (seed, index): ordinary scenes into which values that break programs are put, and bad arguments.

A case is a function of its two numbers alone, so that they are all there is to write down about it.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import torch
from e4dgs.rasterizer import Camera, Convexes, Gaussians
from torch import Tensor

TINY = [0.0, -0.0, 1e-45, -1e-45, 1e-38, 1e-30, 1e-20, 1e-7]
MIDDLE = [0.5 / 255, 1 / 255, 0.99, 1.0, -1.0, 0.5, 15.5, 16.0, 1e3]
HUGE = [1e6, -1e6, 1e12, 1e15, -1e15]
BEYOND = [1e19, -1e19, 1e30, 3e38, -3e38]  # products of these leave float32: what depends on them need not be finite
NOT_FINITE = [float("nan"), float("inf"), float("-inf")]
OUTPUTS = ("color", "alpha", "depth", "extras")
SIZES = [1, 2, 3, 4, 5, 15, 16, 17, 31, 32, 33, 40]


@dataclass
class Case:
    camera: Camera
    gaussians: Gaussians | None
    convexes: Convexes | None
    background: Tensor | None
    validate: bool = False
    wanted: list[str] = field(default_factory=list)  # tensors that require gradients
    grads: dict[str, Tensor | None] = field(default_factory=dict)  # incoming ones, by output
    refused: str = ""  # what is wrong with the arguments, where `rasterize` must raise
    touched: dict[str, np.ndarray] = field(default_factory=dict)  # by kind, rows that hold a planted value
    beyond: bool = False  # whether values were planted that may leave float32's range


class Dice:
    """numpy's generator with the few questions that are asked here."""

    def __init__(self, seed: int, index: int) -> None:
        self.rng = np.random.default_rng([seed, index])

    def chance(self, p: float) -> bool:
        return bool(self.rng.random() < p)

    def pick(self, values: list):  # type: ignore[no-untyped-def, type-arg]
        return values[int(self.rng.integers(len(values)))]

    def normal(self, *shape: int) -> np.ndarray:
        return self.rng.standard_normal(shape)

    def uniform(self, low: float, high: float, *shape: int) -> np.ndarray:
        return self.rng.uniform(low, high, shape)

    def special(self, finite: bool = False, beyond: bool = True) -> float:
        values = TINY + MIDDLE + HUGE + (BEYOND if beyond else []) + ([] if finite else NOT_FINITE)
        return self.pick(values)


def make_case(seed: int, index: int) -> Case:
    dice = Dice(seed, index)
    width, height = dice.pick(SIZES), dice.pick(SIZES)
    if dice.chance(0.03):
        width, height = dice.pick([(300, 1), (1, 300), (129, 70)])
    case = Case(make_camera(dice, width, height), None, None, None)
    extras = dice.pick([None, None, 0, 1, 4, 9])
    for kind, make in (("gaussians", make_gaussians), ("convexes", make_convexes)):
        count = dice.pick([None, 0, 1, 2, 5, 20, 20, 150])
        if count is None:
            continue
        width_of = dice.pick([extras, None])
        tensors = make(dice, count) | make_looks(dice, count, width_of)
        case.touched[kind] = np.zeros(count, bool)
        if count:
            plant(dice, case, kind, tensors)
        owner = Gaussians if kind == "gaussians" else Convexes
        setattr(case, kind, owner(**{name: as_tensor(dice, value) for name, value in tensors.items()}))
    if dice.chance(0.7):
        case.background = as_tensor(dice, dice.uniform(0, 1, 3))
    if dice.chance(0.04):
        spoil(dice, case)
    if not case.refused and dice.chance(0.05):
        case.validate = True
    everything = list(tensors_of(case))
    case.wanted = everything if dice.chance(0.4) else [name for name in everything if dice.chance(0.4)]
    make_grads(dice, case, width, height, output_extras(case))
    return case


def make_camera(dice: Dice, width: int, height: int) -> Camera:
    size = max(width, height)
    K = np.array([[dice.uniform(0.5, 2) * size, 0, width / 2], [0, dice.uniform(0.5, 2) * size, height / 2], [0, 0, 1]])
    pose, near = np.eye(4), 0.01
    if dice.chance(0.7):
        pose[:3, :3] = np.linalg.qr(dice.normal(3, 3))[0]
    pose[:3, 3] = [*dice.uniform(-0.3, 0.3, 2), 4.0]
    if dice.chance(0.15):
        K[dice.pick([0, 1]), :2] *= dice.pick([1e-30, 1e-6, 1e-2, 1e3, 1e9, 1e30])
    if dice.chance(0.1):
        K[dice.pick([0, 1]), 2] = dice.special(finite=True)
    if dice.chance(0.1):
        pose[dice.pick([0, 1, 2]), 3] = dice.special(finite=True)
    if dice.chance(0.05):
        pose[dice.pick([0, 1, 2]), dice.pick([0, 1, 2])] = dice.special(finite=True)
    if dice.chance(0.1):
        near = dice.pick([1e-300, 1e-30, 1e-6, 3.9, 4.0, 100.0, 1e30, 1e300])
    dtype = dice.pick([torch.float32, torch.float64])
    return Camera(torch.tensor(K, dtype=dtype), torch.tensor(pose, dtype=dice.pick([dtype, torch.float64])), width, height, near)


def make_gaussians(dice: Dice, n: int) -> dict[str, np.ndarray]:
    return {
        "means": dice.uniform(-1.5, 1.5, n, 3),
        "quats": dice.normal(n, 4),
        "scales": 0.3 * np.exp(dice.uniform(-3, 1, n, 3)),
        "opacities": dice.uniform(0, 1, n) ** dice.pick([0.1, 1, 3]),
    }


def make_convexes(dice: Dice, m: int) -> dict[str, np.ndarray]:
    k = dice.pick([3, 4, 5, 6, 7, 8])
    return {
        "points": dice.uniform(-1.5, 1.5, m, 1, 3) + dice.pick([0.02, 0.4, 2.0]) * dice.normal(m, k, 3),
        "tau": np.exp(dice.uniform(0, 6, m)),
        "kappa": np.exp(dice.uniform(0, 6, m)),
        "opacities": dice.uniform(0, 1, m) ** dice.pick([0.1, 1, 3]),
    }


def make_looks(dice: Dice, n: int, extras: int | None) -> dict[str, np.ndarray]:
    degree = dice.pick([None, 0, 1, 2, 3])
    looks = {"colors": dice.uniform(-0.2, 1.2, n, 3)} if degree is None else {"sh": 0.4 * dice.normal(n, (degree + 1) ** 2, 3)}
    return looks if extras is None else looks | {"extras": dice.normal(n, extras)}


def plant(dice: Dice, case: Case, kind: str, tensors: dict[str, np.ndarray]) -> None:
    """Special values into a few entries or whole rows, and rows that are copies of others."""
    touched = case.touched[kind]
    n = len(touched)
    if dice.chance(0.3):
        copies = dice.rng.integers(n, size=n)
        for name in tensors if dice.chance(0.5) else ["means" if kind == "gaussians" else "points"]:
            tensors[name] = tensors[name][copies]
    if kind == "convexes" and dice.chance(0.3):
        for row in dice.rng.integers(n, size=3):
            flatten(dice, tensors["points"][row])
    if dice.chance(0.4):
        return
    beyond = dice.chance(0.3)
    for _ in range(dice.pick([1, 1, 2, 6])):
        name = dice.pick([name for name, value in tensors.items() if value.size])
        row = int(dice.rng.integers(n))
        value = dice.special(beyond=beyond)
        flat = tensors[name].reshape(n, -1)
        flat[row, slice(None) if dice.chance(0.4) else int(dice.rng.integers(flat.shape[1]))] = value
        tensors[name] = flat.reshape(tensors[name].shape)
        touched[row] = True
        case.beyond |= beyond


def flatten(dice: Dice, points: np.ndarray) -> None:
    """One convex's points [K, 3]: all at one place, on one line, at two places, in a plane, or with copies."""
    how = dice.pick(["place", "line", "two", "plane", "copies"])
    if how == "place":
        points[:] = points[0]
    elif how == "line":
        points[:] = points[0] + np.linspace(0, 1, len(points))[:, None] * (points[1] - points[0])
    elif how == "two":
        points[2:] = points[0]
    elif how == "plane":
        points[:, 2] = points[0, 2]
    else:
        points[:] = points[dice.rng.integers(len(points), size=len(points))]


def as_tensor(dice: Dice, value: np.ndarray) -> Tensor:
    """float32 or float64; now and then not contiguous."""
    with np.errstate(over="ignore"):
        tensor = torch.tensor(value, dtype=dice.pick([torch.float32, torch.float32, torch.float64]))
    if tensor.dim() > 1 and dice.chance(0.1):
        tensor = tensor.transpose(0, -1).contiguous().transpose(0, -1)
    return tensor


def tensors_of(case: Case) -> dict[str, Tensor]:
    """Every float input by name."""
    found = {"K": case.camera.K, "cam_from_world": case.camera.cam_from_world}
    if case.background is not None:
        found["background"] = case.background
    for kind in ("gaussians", "convexes"):
        for name, value in vars(getattr(case, kind) or object.__new__(Case)).items():
            if isinstance(value, Tensor):
                found[f"{kind}.{name}"] = value
    return found


def output_extras(case: Case) -> int:
    return max((o.extras.shape[1] for o in (case.gaussians, case.convexes) if o is not None and o.extras is not None), default=0)


def spoil(dice: Dice, case: Case) -> None:
    """An argument that must be refused."""
    camera, owner = case.camera, case.gaussians if case.gaussians is not None else case.convexes
    how = dice.pick(["pose", "focal", "near", "size", "skew", "last row", "background", "shape", "looks", "type", "points"])
    if how == "pose":
        camera.cam_from_world[dice.pick([0, 1, 2]), dice.pick([0, 1, 2, 3])] = dice.pick(NOT_FINITE)
    elif how == "focal":
        camera.K[0, 0] = dice.pick([0.0, -1.0, float("nan"), float("inf")])
    elif how == "near":
        camera.near = dice.pick([0.0, -1.0, float("nan"), float("inf")])
    elif how == "size":
        camera.width = dice.pick([0, -1])
    elif how == "skew":
        camera.K[0, 0], camera.K[0, 1] = 10.0, 1.0
    elif how == "last row":
        camera.cam_from_world[3, 3] = dice.pick([0.0, 2.0, float("nan")])
    elif how == "background":
        case.background = torch.tensor([0.0, dice.pick(NOT_FINITE), 1.0])
    elif owner is None:
        return
    elif how == "shape":
        owner.opacities = owner.opacities[None]
    elif how == "looks":
        owner.sh, owner.colors = None, None
    elif how == "type":
        owner.opacities = owner.opacities.to(torch.int64)
    elif case.convexes is not None:
        case.convexes.points = case.convexes.points[:, :2]
    else:
        return
    case.refused = how


def make_grads(dice: Dice, case: Case, width: int, height: int, extras: int) -> None:
    shapes = {"color": (height, width, 3), "alpha": (height, width), "depth": (height, width), "extras": (height, width, extras)}
    for name in OUTPUTS:
        case.grads[name] = None
        if dice.chance(0.3):
            continue
        grad = dice.normal(*shapes[name]) if dice.chance(0.8) else np.full(shapes[name], dice.pick([0.0, 1.0, 1e-38, 1e10]))
        if dice.chance(0.1) and grad.size:
            grad.reshape(-1)[int(dice.rng.integers(grad.size))] = dice.pick(NOT_FINITE)
        case.grads[name] = torch.tensor(grad, dtype=torch.float32)
