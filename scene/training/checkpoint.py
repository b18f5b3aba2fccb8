"""Training state on disk: one safetensors file, written atomically."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from ..colour import CameraAffine
from ..model import Model, motion_from_state
from ..motion.interface import Motion
from ..primitives import ConvexSet, GaussianSet

FILE = "training.safetensors"


def save_checkpoint(folder: Path, tensors: dict[str, Tensor], state: dict[str, Any]) -> None:
    """Write ``tensors`` and the JSON values ``state`` into ``folder``. A reader sees the old file or the new one, never a partial one."""
    from safetensors.torch import save_file

    folder.mkdir(parents=True, exist_ok=True)
    temporary = folder / f".{FILE}.tmp"
    # safetensors rejects tensors that share memory; cloning is cheap compared with the write.
    save_file({k: v.detach().cpu().clone().contiguous() for k, v in tensors.items()}, temporary, metadata={"state": json.dumps(state)})
    with open(temporary, "rb") as handle:
        os.fsync(handle.fileno())
    os.replace(temporary, folder / FILE)


def load_checkpoint(folder: Path) -> tuple[dict[str, Tensor], dict[str, Any]] | None:
    """The newest checkpoint, or None if there is none or it cannot be read (training then starts over)."""
    from safetensors import SafetensorError, safe_open

    path = folder / FILE
    if not path.is_file():
        return None
    try:
        with safe_open(path, framework="pt") as handle:
            state = json.loads((handle.metadata() or {})["state"])
            tensors: dict[str, torch.Tensor] = {key: handle.get_tensor(key) for key in handle.keys()}  # noqa: SIM118
    except (SafetensorError, KeyError, ValueError, OSError):
        return None
    return tensors, state


def restore(model: Model, tensors: dict[str, Tensor], state: dict[str, Any]) -> None:
    """Give ``model`` the primitives, the motion and the camera colours from what `load_checkpoint` returned."""
    device = model.device
    motion = _motion(tensors, state)
    gaussians, convexes = _primitives(tensors, motion)
    model.gaussians, model.convexes = gaussians.to(device), convexes.to(device)
    model.motion = motion.to(device)
    for primitives in (model.gaussians, model.convexes):
        if f"link/{primitives.KIND}" in tensors:
            model.set_links(primitives, tensors[f"link/{primitives.KIND}"].to(device))
    if model.affine is not None:
        with torch.no_grad():
            for name, p in model.affine.named_parameters():
                p.copy_(tensors[f"parameter/affine.{name}"])


def _motion(tensors: dict[str, Tensor], state: dict[str, Any]) -> Motion:
    motion = {name.removeprefix("motion/"): value for name, value in tensors.items() if name.startswith("motion/")}
    return motion_from_state(motion, state["model"]["field"])


def _primitives(tensors: dict[str, Tensor], motion: Motion) -> tuple[GaussianSet, ConvexSet]:
    def of(kind: Any) -> Any:
        parameters = {name: tensors[f"parameter/{kind.KIND}.{name}"] for name in (*kind.FIELDS, *motion.attributes)}
        return kind(parameters, tensors[f"dynamic/{kind.KIND}"])

    return of(GaussianSet), of(ConvexSet)


def model_of(folder: Path) -> tuple[Model, int] | None:
    """The model of the newest checkpoint and the step at which it was written; None in the same cases as `load_checkpoint`."""
    found = load_checkpoint(folder)
    if found is None:
        return None
    tensors, state = found
    config = state["model"]
    motion = _motion(tensors, state)
    affine = None if config["affine_cameras"] is None else CameraAffine(config["affine_cameras"])
    background, antialiased = tuple(config["background"]), bool(config["antialiased"])
    sets = _primitives(tensors, motion)
    model = Model(*sets, motion, int(config["sh_degree"]), float(config["near"]), background, affine, antialiased)
    restore(model, tensors, state)
    return model, int(state["iteration"])
