"""A trained model as the data of the web player: what is drawn, in an order that compresses well, with steps that cannot be seen."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .web_motion import motion_arrays, numbers

if TYPE_CHECKING:
    from ...scene.formats.web.scene import WebScene
    from ...scene.model import Model
    from ...scene.primitives import PrimitiveSet

LEAST_ALPHA = 1 / 255  # the rasterizer draws nothing below this
POSITION = 0.06  # step of positions, in pixels of the capture at the distance of its cameras
STEPS = {"opacity": 1 / 300, "color": 0.008, "sh1": 0.012, "sh2": 0.016, "sh3": 0.02, "scales": 0.02, "turns": 0.004, "shape": 0.02}
SHADE = 1 / 300  # step of shades, times the strongest light


def web_scene(model: Model, times: int, pixel: float, about: dict[str, Any]) -> tuple[WebScene, dict[str, Any]]:
    """``model`` as a `WebScene`, and the step of each of its arrays.

    times: of the capture. pixel: width of a pixel where the scene is, world units. about: further fields of the header (see
    `layout.check_header`): seconds, up, target, cameras. What is too faint to be drawn and what is not finite is left out.
    """
    import torch

    from ...scene.formats.web.scene import WebScene

    with torch.no_grad():
        kept = {kind: in_order(primitives, model) for kind, primitives in (("g", model.gaussians), ("c", model.convexes))}
        header: dict[str, Any] = {
            "gaussians": list(kept["g"][1]),
            "convexes": list(kept["c"][1]),
            "corners": model.convexes.points.shape[1],
            "sh_degree": min(model.sh_degree, degree_of(model.gaussians)),
            "frames": max(1, times),
            "near": model.near,
            "background": [float(x) for x in model.background],
            "antialiased": model.antialiased,
        }
        arrays: dict[str, Any] = {}
        steps: dict[str, Any] = {"g_means": POSITION * pixel, "c_points": POSITION * pixel}
        axes = None
        for kind, (index, _) in kept.items():
            primitives = (model.gaussians if kind == "g" else model.convexes).select(index)
            arrays |= {f"{kind}_{name}": value for name, value in look_arrays(primitives, header["sh_degree"]).items()}
            if kind == "g":
                shape, axes = gaussian_shapes(primitives)
                arrays |= shape
            else:
                arrays["c_points"] = numbers(primitives.points)
                arrays["c_shape"] = numbers(torch.stack([primitives.log_tau, primitives.log_kappa], 1))
        steps |= {name: STEPS[name.split("_")[1]] for name in arrays if name.split("_")[1] in STEPS}
        moved = motion_arrays(model, kept["g"], kept["c"], axes, times, POSITION * pixel)
        header |= moved.header
        arrays, steps = arrays | moved.arrays, steps | moved.steps
        for kind, (index, _) in kept.items():
            if header["light"]:
                primitives = model.gaussians if kind == "g" else model.convexes
                arrays[f"{kind}_shades"] = numbers(primitives.shades[index])
                steps[f"{kind}_shades"] = SHADE / max(float(np.abs(arrays["light"]).max()), 1e-6)
    arrays = {name: np.asarray(values, np.float64) for name, values in arrays.items()}
    return WebScene(header | about, {name: v if v.ndim == 3 else v[:, None] for name, v in arrays.items()}), steps


def degree_of(primitives: PrimitiveSet) -> int:
    return round((primitives.sh_rest.shape[1] + 1) ** 0.5) - 1


def in_order(primitives: PrimitiveSet, model: Model):
    """Indices of those that are drawn, still ones first, neighbours near one another; and (still, moving), how many there are of each."""
    import torch

    from ...scene.formats.compressed_ply import morton

    drawn = primitives.opacities >= LEAST_ALPHA
    for value in primitives.parameters.values():
        drawn = drawn & torch.isfinite(value).reshape(len(primitives), value[0].numel() if len(primitives) else 1).all(1)
    moving = primitives.dynamic if not model.motion.static else torch.zeros_like(primitives.dynamic)
    centres = primitives.rest_points().detach().reshape(len(primitives), -1, 3).mean(1) if len(primitives) else torch.zeros(0, 3)
    code = torch.tensor(morton(centres.numpy(), 1))
    found = [torch.nonzero(drawn & which)[:, 0] for which in (~moving, moving)]
    found = [index[torch.argsort(code[index], stable=True)] for index in found]
    return torch.cat(found), (len(found[0]), len(found[1]))


def look_arrays(primitives: PrimitiveSet, degree: int) -> dict[str, np.ndarray]:
    """Opacity and SH by bands; a set with fewer bands has zeros in the others."""
    rows = len(primitives)
    rest = np.zeros((rows, (degree + 1) ** 2 - 1, 3))
    own = numbers(primitives.sh_rest)[:, : rest.shape[1]]
    rest[:, : own.shape[1]] = own
    bands = {f"sh{d}": rest[:, d * d - 1 : (d + 1) ** 2 - 1].reshape(rows, 3 * (2 * d + 1)) for d in range(1, degree + 1)}
    return {"opacity": numbers(primitives.opacities)[:, None], "color": numbers(primitives.sh_dc)[:, 0]} | bands


def gaussian_shapes(gaussians: PrimitiveSet):
    """Means, rotations and ln scales, and the axes [n, 3] that each Gaussian's own were renamed to.

    Of the 24 ways to name the axes of a Gaussian, the one that needs the smallest rotation is taken: w of its quaternion is then the
    largest component.
    """
    quats = numbers(gaussians.quats)
    quats /= np.maximum(np.linalg.norm(quats, axis=1, keepdims=True), 1e-12)
    namings, permuted = axis_namings()
    w = quats @ (namings * [1, -1, -1, -1]).T  # of the product with each naming
    best = np.abs(w).argmax(1)
    a, b = quats, namings[best]
    turned = np.stack(
        [
            a[:, 0] * b[:, 0] - a[:, 1] * b[:, 1] - a[:, 2] * b[:, 2] - a[:, 3] * b[:, 3],
            a[:, 0] * b[:, 1] + a[:, 1] * b[:, 0] + a[:, 2] * b[:, 3] - a[:, 3] * b[:, 2],
            a[:, 0] * b[:, 2] - a[:, 1] * b[:, 3] + a[:, 2] * b[:, 0] + a[:, 3] * b[:, 1],
            a[:, 0] * b[:, 3] + a[:, 1] * b[:, 2] - a[:, 2] * b[:, 1] + a[:, 3] * b[:, 0],
        ],
        1,
    )
    turned *= np.where(turned[:, :1] < 0, -1, 1)
    axes = permuted[best]
    scales = np.take_along_axis(numbers(gaussians.log_scales), axes, 1)
    return {"g_means": numbers(gaussians.means), "g_turns": turned[:, 1:], "g_scales": scales.clip(-40, 40)}, axes


def axis_namings() -> tuple[np.ndarray, np.ndarray]:
    """The 24 rotations of a cube as unit quaternions [24, 4], and for each [24, 3]: the old axis that each new axis is."""
    from scipy.spatial.transform import Rotation

    group = Rotation.create_group("O")
    return group.as_quat()[:, [3, 0, 1, 2]], np.abs(group.as_matrix()).argmax(1)
