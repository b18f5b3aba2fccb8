"""Moving Gaussians as a `.4dgs` file of the model `gaussian-birth` (github.com/avala-ai/4dgs, specification 1), by the package fourdgs.

A Gaussian of that model has a mean time, a spread over time, a velocity and a window, which is what `Pieces` have. Quaternions are x y z w,
scales and opacities as they are, colours 0.5 + SH_C0 dc in [0, 1], SH of higher degrees in steps of 8/255 within 4.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from io import BytesIO

import numpy as np
import torch

from ...rasterizer import Gaussians
from ..primitives import SH_C0
from .axes import Turn
from .pieces import ALWAYS, Pieces
from .ply import LEAST_ALPHA

QUALITY = "fine"  # of the package's three; it states the largest error of each number in the file
RANGE = 4.0  # of SH coefficients
FORWARD = {"X": "Y", "Y": "-Z", "Z": "Y"}  # an axis that is not up; which one is ours to say


@dataclass
class View:
    """Where a player begins: the vertical field of view in degrees, a place and a point to look at [3]."""

    angle: float
    place: np.ndarray
    target: np.ndarray


@dataclass
class Clock:
    """span: seconds from time 0 of the pieces to time 1. seconds: how long the file plays, which is longer: its last picture stays on."""

    span: float
    seconds: float


def container_bytes(pieces: Pieces, clock: Clock, turn: Turn, view: View, title: str) -> bytes:
    """The file with ``pieces``, which are already in its axes. turn: to these axes, which the file names. Raises ImportError without the
    package."""
    import fourdgs

    target = BytesIO()
    look = pieces.gaussians
    bands = look.sh.shape[1] if look.sh is not None else 1
    axes = fourdgs.CoordinateFrame(
        handedness=1, up_axis=signed(turn.after), forward_axis=signed(FORWARD[turn.after[-1]]), length_unit=0, metres_per_unit=0.0
    )
    options = fourdgs.WriteOptions(
        profile=QUALITY,
        cutoff=LEAST_ALPHA,
        library="e4dgs",
        write_statistics=True,
        metadata={
            "title": title,
            **({"coordinate_system": f"{turn.after.lower()}-up-right-handed"} if turn.after in ("Y", "Z") else {}),
            "color_space": "srgb-rec709-display",
            "visibility_profile": "gaussian" if bool(pieces.spreads.isfinite().any()) else "box",
        },
        provenance=fourdgs.Provenance(frames=[axes]),
    )
    camera = fourdgs.CameraTrajectory(view.angle, *(tuple(float(x) for x in one) for one in (view.place, view.target)))
    fourdgs.write(target, gaussian_set(pieces, clock, round(bands**0.5) - 1), clock.seconds, options=options, camera=camera)
    return target.getvalue()


def gaussian_set(pieces: Pieces, clock: Clock, degree: int):
    """``pieces`` as the package's own, on its clock."""
    import fourdgs
    from fourdgs.quantization import Bounds, Steps

    span, look = clock.span, pieces.gaussians
    assert look.sh is not None
    sh = look.sh.double()
    spreads = torch.where(pieces.spreads < ALWAYS, pieces.spreads * span, torch.inf)
    scales = look.scales.double().numpy()
    # Mean times are rounded; a mean is moved along its path to where the file says that it is.
    step = Steps.of(Bounds.for_profile(QUALITY, median_scale=float(np.median(scales)) if len(scales) else 1e-3)).time
    middles = torch.where(spreads.isinf(), torch.round(pieces.middles * span / step) * step, pieces.middles * span)
    means = look.means.double() + pieces.velocities.double() * (middles / span - pieces.middles)[:, None]
    colors = torch.cat([(0.5 + SH_C0 * sh[:, 0]).clamp(0, 1), look.opacities.double()[:, None].clamp(0, 1)], 1)
    coefficients = sh[:, 1:].clamp(-RANGE, RANGE).transpose(1, 2).reshape(len(sh), -1)  # by colour, then coefficient
    single = {
        "positions": means,
        "scales": look.scales,
        "rotations": torch.nn.functional.normalize(look.quats, dim=1)[:, [1, 2, 3, 0]],
        "colors": colors,
        "motions": pieces.velocities / span,
        "mu_t": middles,
        "sigma_t": spreads,
    }
    return fourdgs.GaussianSet(
        **{name: value.numpy().astype(np.float32) for name, value in single.items()},
        win_lo=(pieces.low * span).clamp(min=0.0).double().numpy(),
        win_hi=torch.where(pieces.high > 1, clock.seconds, pieces.high * span).double().numpy(),
        sh=np.rint((coefficients.numpy() + RANGE) * (255 / (2 * RANGE))).astype(np.uint8) if degree else None,
        sh_degree=degree,
    )


def read_container(data: bytes) -> Callable[[float], Gaussians]:
    """A function from seconds to the Gaussians of the file then, by the package's decoder."""
    import fourdgs

    scene = fourdgs.read(data)
    kept = scene.gaussians

    def at(second: float) -> Gaussians:
        state = kept.state_at(second, scene.header.cutoff)
        index = state["indices"]
        dc = (torch.tensor(kept.colors[index, :3]).double() - 0.5) / SH_C0
        rest = torch.zeros(len(index), 0, 3).double()
        if kept.sh is not None:
            numbers = kept.sh[index].astype(np.float64) * (2 * RANGE / 255) - RANGE
            rest = torch.tensor(numbers).reshape(len(index), 3, numbers.shape[1] // 3).transpose(1, 2)
        parts = (state["centers"], state["orientations"][:, [3, 0, 1, 2]], kept.scales[index], state["opacity"])
        means, quats, scales, opacities = (torch.tensor(np.asarray(part, np.float32)) for part in parts)
        return Gaussians(means, quats, scales, opacities, sh=torch.cat([dc[:, None], rest], 1).float())

    return at


def signed(axis: str) -> int:
    """A signed axis as the format counts them: x y z, then -x -y -z."""
    return "XYZ".index(axis[-1]) + 3 * axis.startswith("-")
