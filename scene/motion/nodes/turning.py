"""Makes a part that was found to turn a rigid one that turns at the rate found, with new Gaussians around its centre."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import ClassVar, Protocol, Self, TypeVar

import numpy as np
import torch
from scipy.ndimage import gaussian_filter1d, median_filter
from scipy.spatial.transform import Rotation
from torch import Tensor

from ....rasterizer import Camera
from ...primitives import Attribute, ConvexSet, GaussianSet, PrimitiveSet
from ...views import Views
from ..interface import Moved, Scene
from .rigid_parts import RigidParts
from .steady_turn import Part, SteadyTurn, TurnSearch, compact_parts

WIDER = 1.2  # radius of the rigid part, relative to that of the part found, whose ragged rim leaves some of it out
FRESH = 1500  # Gaussians that a rigid part starts with
MOST_PARTS = 3
MEDIAN, SMOOTH = 5, 1.5  # frames: median window and standard deviation of the Gaussian that smooth the path of a part
FRAMES_PER_KEY = 2  # one key a frame instead lost 2.3 dB on validation views of a tumbling cube


class Jointed(Protocol):
    """What is asked here of `ControlNodes`."""

    attributes: ClassVar[Mapping[str, Attribute]]
    extent: float
    rigid_parts: RigidParts

    def carried(self, scene: Scene, index: Tensor, t: float) -> Moved: ...
    def links(self, primitives: PrimitiveSet) -> Tensor: ...
    def in_rigid_parts(self, scene: Scene) -> Tensor: ...
    def with_rigid_parts(self, rigid_parts: RigidParts) -> Self: ...


Turning = TypeVar("Turning", bound=Jointed)


class _Changed:
    """A scene whose motion and Gaussians were changed, and are not those of the model yet."""

    def __init__(self, nodes: Jointed, gaussians: GaussianSet, convexes: ConvexSet) -> None:
        self.gaussians, self.convexes = gaussians, convexes
        self._links = {one.KIND: nodes.links(one) for one in (gaussians, convexes)}

    def moving(self, primitives: PrimitiveSet, camera: Camera | None = None) -> Tensor:
        return primitives.dynamic.nonzero()[:, 0]

    def links(self, primitives: PrimitiveSet) -> Tensor | None:
        return self._links[primitives.KIND]


def make_turning_parts_rigid(
    nodes: Turning, scene: Scene, views: Views, error: Tensor, seed: int, say: Callable[[str], None]
) -> tuple[Turning, GaussianSet, Tensor] | None:
    """Search for steady turns in the parts with much of the ``error`` [N] of the Gaussians, and make each part that turns rigid. Existing
    rigid parts are left alone. Returns nodes with these rigid parts, Gaussians, and the old row of each (-1 if new); None if nothing
    turns."""
    source = None
    error = torch.where(nodes.in_rigid_parts(scene), 0.0, error)
    for part in compact_parts(scene.gaussians.means.detach().cpu().numpy(), error.cpu().numpy())[:MOST_PARTS]:
        frames = views.train[np.argsort(views.time[views.train], kind="stable")]
        search = TurnSearch(views, frames, part_path(nodes, scene, part, views.time[frames]), part.radius)
        turn = search.find()
        if turn is None:
            say(f"a part holds {part.share:.0%} of the error; no steady turn explains it")
            continue
        degrees = np.degrees(np.linalg.norm(turn.omega))
        say(f"a part that holds {part.share:.0%} of the error turns by {degrees:.1f} degrees a frame; it moves as one rigid part from here")
        nodes, gaussians, kept = _make_rigid(nodes, scene.gaussians, part, turn, search, views.time[frames], seed)
        scene = _Changed(nodes, gaussians, scene.convexes)
        source = kept if source is None else torch.where(kept >= 0, source[kept.clamp(min=0)], kept)
        error = torch.where(kept >= 0, error[kept.clamp(min=0)], torch.zeros((), device=error.device))
    return None if source is None else (nodes, scene.gaussians, source)


def leave_only(chosen: Tensor, parameters: Mapping[str, Tensor], of_parts: str) -> None:
    """Clear the gradients of all ``parameters`` but the rows of the Gaussians ``chosen`` [N] bool and what is named ``of_parts``..."""
    for name, parameter in parameters.items():
        if parameter.grad is None or name.startswith(of_parts):
            continue
        if name.startswith("gaussians."):
            parameter.grad[~chosen] = 0.0
        else:
            parameter.grad = None


@torch.no_grad()
def part_path(nodes: Jointed, scene: Scene, part: Part, times: np.ndarray) -> np.ndarray:
    """[n, 3] mean position of the part's Gaussians at ``times`` [n], world units, with jumps in single frames smoothed out."""
    means = scene.gaussians.means.detach()
    members = ((means - torch.tensor(part.centre, device=means.device)).norm(dim=1) <= part.radius).nonzero()[:, 0]
    path = np.stack([nodes.carried(scene, members, float(t)).points.mean(0).cpu().numpy() for t in times])
    # The blurred part is placed wherever it looks best in each frame; the real part moves more steadily.
    return gaussian_filter1d(median_filter(path, (MEDIAN, 1), mode="nearest"), SMOOTH, axis=0, mode="nearest")


@torch.no_grad()
def _make_rigid(
    nodes: Turning, gaussians: GaussianSet, part: Part, turn: SteadyTurn, search: TurnSearch, times: np.ndarray, seed: int
) -> tuple[Turning, GaussianSet, Tensor]:
    means, device = gaussians.means.detach(), gaussians.device
    centre = torch.tensor(part.centre + turn.offset, dtype=torch.float32, device=device)
    radius = WIDER * part.radius
    keys = len(nodes.rigid_parts.quats) if len(nodes.rigid_parts) else max(2, len(times) // FRAMES_PER_KEY)
    at = np.interp(np.linspace(0, 1, keys), times, np.arange(len(times)))
    turns = Rotation.from_rotvec((at - 0.5 * (len(times) - 1))[:, None] * turn.omega).as_quat()[:, [3, 0, 1, 2]]
    path = search.path.cpu().numpy() + turn.offset
    path = np.stack([np.interp(at, np.arange(len(times)), path[:, axis]) for axis in range(3)], 1)
    shifts = torch.tensor(path).float().to(device) - centre
    nodes = nodes.with_rigid_parts(nodes.rigid_parts.joined(centre, radius, torch.tensor(turns).float().to(device), shifts))

    outside = (means - centre).norm(dim=1).minimum((means - torch.tensor(part.centre, device=device)).norm(dim=1)) > radius
    kept = outside.nonzero()[:, 0]
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(FRESH, 3))
    points *= part.radius * rng.uniform(size=(FRESH, 1)) ** (1 / 3) / np.linalg.norm(points, axis=1, keepdims=True)
    bands = 1 + gaussians.sh_rest.shape[1]
    fresh = GaussianSet.from_points(centre.cpu().numpy() + points, np.full((FRESH, 3), 0.5), round(bands**0.5) - 1).to(device)
    fresh = fresh.carrying(nodes.attributes)
    fresh.hyper.copy_(nodes.rigid_parts.hyper(nodes.extent)[-1:].expand(FRESH, -1))
    return nodes, GaussianSet.joined([gaussians.select(kept), fresh]), torch.cat([kept, kept.new_full((FRESH,), -1)])
