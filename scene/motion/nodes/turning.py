"""Makes a part that was found to spin a rigid one that turns at the rate found, with new Gaussians around its centre."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from scipy.ndimage import gaussian_filter1d, median_filter
from scipy.spatial.transform import Rotation
from torch import Tensor

from ...model import Model
from ...primitives import GaussianSet
from ...views import Views
from .control_nodes import ControlNodes
from .steady_turn import Part, Spin, SpinSearch, compact_parts

WIDER = 1.2  # radius of the rigid part, relative to that of the part found, whose ragged rim leaves some of it out
FRESH = 1500  # Gaussians that a rigid part starts with
MOST_PARTS = 3
MEDIAN, SMOOTH = 5, 1.5  # frames: median window and standard deviation of the Gaussian that smooth the path of a part
FRAMES_PER_KEY = 2  # one key a frame instead lost 2.3 dB on validation views of a tumbling cube


def make_turning_parts_rigid(model: Model, views: Views, error: Tensor, seed: int, log: Callable[[str], None]) -> Tensor | None:
    """Search for steady turns in the parts with much of the ``error`` [N] of the Gaussians, and make each part that turns rigid.

    Existing rigid parts are left alone. The model must be moved by `ControlNodes`; its motion is replaced. Returns the old row of each row
    of the new ``model.gaussians`` (-1 if new), or None if nothing turns.
    """
    source = None
    error = torch.where(bound_to_rigid_parts(model), 0.0, error)
    for part in compact_parts(model.gaussians.means.detach().cpu().numpy(), error.cpu().numpy())[:MOST_PARTS]:
        frames = views.train[np.argsort(views.time[views.train], kind="stable")]
        search = SpinSearch(views, frames, part_path(model, part, views.time[frames]), part.radius)
        spin = search.find()
        if spin is None:
            log(f"a part holds {part.share:.0%} of the error; no steady turn explains it")
            continue
        degrees = np.degrees(np.linalg.norm(spin.omega))
        log(f"a part that holds {part.share:.0%} of the error turns by {degrees:.1f} degrees a frame; it moves as one rigid part from here")
        kept = _make_rigid(model, part, spin, search, views.time[frames], seed)
        source = kept if source is None else torch.where(kept >= 0, source[kept.clamp(min=0)], kept)
        error = torch.where(kept >= 0, error[kept.clamp(min=0)], torch.zeros((), device=error.device))
    return source


def bound_to_rigid_parts(model: Model) -> Tensor:
    """[N] bool: the Gaussians that belong to a rigid part."""
    assert isinstance(model.field, ControlNodes)
    return model.field.in_rigid_parts(model.links(model.gaussians))


def leave_only_rigid_parts(model: Model, parameters: dict[str, Tensor]) -> None:
    """Clear the gradients of all ``parameters`` (by the trainer's names) that do not belong to a rigid part."""
    others = ~bound_to_rigid_parts(model)
    for name, parameter in parameters.items():
        if parameter.grad is None or name.startswith("field.rigid_parts."):
            continue
        if name.startswith("gaussians."):
            parameter.grad[others] = 0.0
        else:
            parameter.grad = None


@torch.no_grad()
def part_path(model: Model, part: Part, times: np.ndarray) -> np.ndarray:
    """[n, 3] mean position of the part's Gaussians at ``times`` [n], world units, with jumps in single frames smoothed out."""
    means = model.gaussians.means.detach()
    members = ((means - torch.tensor(part.centre, device=means.device)).norm(dim=1) <= part.radius).nonzero()[:, 0]
    path = np.stack([model.carried(members, float(t)).points.mean(0).cpu().numpy() for t in times])
    # The blurred part is placed wherever it looks best in each frame; the real part moves more steadily.
    return gaussian_filter1d(median_filter(path, (MEDIAN, 1), mode="nearest"), SMOOTH, axis=0, mode="nearest")


@torch.no_grad()
def _make_rigid(model: Model, part: Part, spin: Spin, search: SpinSearch, times: np.ndarray, seed: int) -> Tensor:
    nodes, gaussians = model.field, model.gaussians
    assert isinstance(nodes, ControlNodes)
    means, device = gaussians.means.detach(), model.device
    centre = torch.tensor(part.centre + spin.offset, dtype=torch.float32, device=device)
    radius = WIDER * part.radius
    keys = len(nodes.rigid_parts.quats) if len(nodes.rigid_parts) else max(2, len(times) // FRAMES_PER_KEY)
    at = np.interp(np.linspace(0, 1, keys), times, np.arange(len(times)))
    turns = Rotation.from_rotvec((at - 0.5 * (len(times) - 1))[:, None] * spin.omega).as_quat()[:, [3, 0, 1, 2]]
    path = search.path.cpu().numpy() + spin.offset
    path = np.stack([np.interp(at, np.arange(len(times)), path[:, axis]) for axis in range(3)], 1)
    shifts = torch.tensor(path).float().to(device) - centre
    model.field = nodes.with_rigid_parts(nodes.rigid_parts.joined(centre, radius, torch.tensor(turns).float().to(device), shifts))

    outside = (means - centre).norm(dim=1).minimum((means - torch.tensor(part.centre, device=device)).norm(dim=1)) > radius
    kept = outside.nonzero()[:, 0]
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(FRESH, 3))
    points *= part.radius * rng.uniform(size=(FRESH, 1)) ** (1 / 3) / np.linalg.norm(points, axis=1, keepdims=True)
    bands = 1 + gaussians.sh_rest.shape[1]
    fresh = GaussianSet.from_points(centre.cpu().numpy() + points, np.full((FRESH, 3), 0.5), round(bands**0.5) - 1).to(device)
    fresh.hyper.copy_(model.field.rigid_parts.hyper(model.field.extent)[-1:].expand(FRESH, -1))
    old = gaussians.select(kept)
    parameters = {name: torch.cat([old.parameters[name].detach(), fresh.parameters[name].detach()]) for name in GaussianSet.FIELDS}
    model.gaussians = GaussianSet(parameters, torch.cat([old.dynamic, fresh.dynamic]))
    return torch.cat([kept, kept.new_full((FRESH,), -1)])
