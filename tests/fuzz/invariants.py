"""What must hold of `rasterize` for any arguments. `run` says in words what a case did, or raises Broken."""

from __future__ import annotations

from dataclasses import replace

import torch
from e4dgs.rasterizer import Frame, rasterize
from e4dgs.rasterizer.validate import bad_values, usable
from torch import Tensor

from .cases import OUTPUTS, Case, tensors_of


class Broken(AssertionError):
    """An invariant does not hold."""


def require(holds: bool, message: str) -> None:
    if not holds:
        raise Broken(message)


def same(a: Tensor, b: Tensor) -> bool:
    """Equal to the last bit, NaN being equal to NaN."""
    return torch.equal(a, b) or (torch.equal(a.isnan(), b.isnan()) and torch.equal(a.nan_to_num(), b.nan_to_num()))


def leaves_of(case: Case) -> dict[str, Tensor]:
    return {n: v.detach().clone().requires_grad_(n in case.wanted and v.is_floating_point()) for n, v in tensors_of(case).items()}


def render(case: Case, leaves: dict[str, Tensor], threads: int) -> Frame:
    torch.set_num_threads(threads)
    camera = replace(case.camera, K=leaves["K"], cam_from_world=leaves["cam_from_world"])
    owners = []
    for kind in ("gaussians", "convexes"):
        owner = getattr(case, kind)
        fields = {name.split(".")[1]: value for name, value in leaves.items() if name.startswith(kind)}
        owners.append(None if owner is None else replace(owner, **fields))
    return rasterize(camera, *owners, leaves.get("background"), backend="cpu", validate=case.validate)


def differentiate(case: Case, frame: Frame, leaves: dict[str, Tensor]) -> dict[str, Tensor]:
    """Gradients by input, of those that are wanted; zero where nothing leads to them."""
    given = [(getattr(frame, n), g) for n, g in case.grads.items() if g is not None and getattr(frame, n).requires_grad]
    wanted = [name for name in leaves if name in case.wanted]
    if not given or not wanted:
        return {}
    found = torch.autograd.grad([o for o, _ in given], [leaves[n] for n in wanted], [g for _, g in given], allow_unused=True)
    return {n: torch.zeros_like(leaves[n]) if g is None else g for n, g in zip(wanted, found)}


def run(case: Case) -> str:
    """One thread and two, forward and backward, and all that is asked of the results. Returns what kind of thing happened."""
    leaves = leaves_of(case)
    bad = {k: ~usable(getattr(case, k)) for k in case.touched if not case.refused}
    must_raise = bool(case.refused) or (case.validate and any(bool(mask.any()) for mask in bad.values()))
    try:
        frame = render(case, leaves, 1)
    except (ValueError, TypeError) as error:
        require(must_raise, f"refused a good call: {error}")
        if case.validate:
            kind, name = str(error).split("[")[0].split(".")
            require(bool(bad_values(getattr(case, kind))[name].any()), f"names a field that is good: {error}")
        return f"refused: {case.refused or 'a bad value'}"
    require(not must_raise, f"took what must be refused: {case.refused or 'a bad value'}")

    check_image(case, frame)
    gradients = differentiate(case, frame, leaves)
    again_leaves = leaves_of(case)
    again = render(case, again_leaves, 2)
    for name in (*OUTPUTS, "visible_gaussians", "visible_convexes"):
        require(same(getattr(frame, name), getattr(again, name)), f"{name} differs with two threads")
    for name, gradient in differentiate(case, again, again_leaves).items():
        require(same(gradient, gradients[name]), f"gradient of {name} differs with two threads")

    check_culled(case, frame, gradients, bad)
    check_finite_gradients(case, gradients)
    if any(bool(mask.any()) for mask in bad.values()):
        check_alone(case, frame, gradients, bad)
    return kind_of(case, frame, gradients, bad)


def check_image(case: Case, frame: Frame) -> None:
    require(frame.color.shape == (case.camera.height, case.camera.width, 3), "the image has another size")
    require(bool(((frame.alpha >= 0) & (frame.alpha <= 1)).all()), "alpha is outside [0, 1]")
    require(bool((frame.depth >= 0).all()), "a depth is negative or not a number")
    require(bool(frame.depth[frame.alpha == 0].eq(0).all()), "a depth where nothing is drawn")
    if not case.beyond:
        for name in OUTPUTS:
            require(bool(torch.isfinite(getattr(frame, name)).all()), f"{name} is not finite")


def check_culled(case: Case, frame: Frame, gradients: dict[str, Tensor], bad: dict[str, Tensor]) -> None:
    for kind, mask in bad.items():
        visible = getattr(frame, f"visible_{kind}")
        require(not bool(visible[mask].any()), f"{kind}: a bad row is visible")
        for name, gradient in gradients.items():
            if name.startswith(kind):
                require(not bool(gradient[mask].any()), f"gradient of {name}: a bad row's is not zero")


def check_finite_gradients(case: Case, gradients: dict[str, Tensor]) -> None:
    """Rows into which nothing was planted, under an ordinary camera, of finite incoming gradients of ordinary size."""
    incoming = [g for g in case.grads.values() if g is not None]
    K, pose = case.camera.K.detach(), case.camera.cam_from_world.detach()
    ordinary = (
        float(K.abs().max()) < 1e6 and float(K.diagonal().min()) > 1e-2 and float(pose.abs().max()) < 1e7 and case.camera.near >= 1e-3
    )
    if case.beyond or not ordinary or not all(bool((g.abs() <= 1e10).all()) for g in incoming):
        return
    for kind, touched in case.touched.items():
        clean = torch.from_numpy(~touched)
        for name, gradient in gradients.items():
            if name.startswith(kind):
                require(bool(torch.isfinite(gradient[clean]).all()), f"gradient of {name} is not finite")


def check_alone(case: Case, frame: Frame, gradients: dict[str, Tensor], bad: dict[str, Tensor]) -> None:
    """Bad rows replaced by invisible ones of good values: nothing else may change, not by a bit."""
    clean = {}
    for name, value in tensors_of(case).items():
        kind, _, field = name.partition(".")
        clean[name] = value.clone()
        if field and bool(bad[kind].any()):
            clean[name][bad[kind]] = 0.0 if field == "opacities" else 0.5
    leaves = {name: value.requires_grad_(name in case.wanted) for name, value in clean.items()}
    without = render(case, leaves, 1)
    for name in OUTPUTS:
        require(same(getattr(frame, name), getattr(without, name)), f"a bad row changes {name}")
    for name, gradient in differentiate(case, without, leaves).items():
        kind = name.partition(".")[0]
        mine = gradients[name].clone()
        if kind in bad:
            mine[bad[kind]], gradient[bad[kind]] = 0.0, 0.0
        require(same(mine, gradient), f"a bad row changes the gradient of {name}")


def kind_of(case: Case, frame: Frame, gradients: dict[str, Tensor], bad: dict[str, Tensor]) -> str:
    """Words for what happened, coarse enough to be few: cases of one kind took about the same way through the kernels."""
    top = float(frame.alpha.detach().max())
    drawn = [kind for kind in ("gaussians", "convexes") if bool(getattr(frame, f"visible_{kind}").any())]
    words = [" and ".join(drawn) or "nothing", "nothing" if top == 0 else "stopped" if top > 0.9998 else "translucent"]
    if drawn and frame.extras.shape[-1]:
        words.append("extras")
    if any(bool(mask.any()) for mask in bad.values()):
        words.append("bad rows")
    if any(bool(g.any()) for g in gradients.values()):
        finite = all(bool(torch.isfinite(g).all()) for g in gradients.values())
        words.append("gradients" if finite else "gradients not finite")
    return ", ".join(dict.fromkeys(words))
