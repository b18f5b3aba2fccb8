"""Weights of RAFT for tests: random ones, under the names of either publisher."""

import numpy as np
import torch
from e4dgs.vision.flow.raft.architecture import Architecture, expected_shapes
from torch import Tensor


def random_state(a: Architecture, seed: int = 0) -> dict[str, Tensor]:
    """Weights that keep activations of order one."""
    g = torch.Generator().manual_seed(seed)
    state = {}
    for name, shape in expected_shapes(a).items():
        scale = (2 / np.prod(shape[1:])) ** 0.5 if len(shape) > 1 else 0.1
        value = scale * torch.randn(shape, generator=g)
        state[name] = 1 + value.abs() if name.endswith(("running_var", "norm1.weight", "norm2.weight")) else value
    return state


def torchvisions(name: str, small: bool) -> str:
    """A tensor's name in torchvision: their modules nest convolution and norm in a sequence."""
    part, _, rest = name.partition(".")
    if part in ("fnet", "cnet"):
        rest = (
            {"conv1": "convnormrelu.0", "norm1": "convnormrelu.1", "conv2": "conv"}.get(rest.rpartition(".")[0], "")
            + "."
            + rest.split(".")[-1]
            if (rest.count(".") == 1)
            else rest
        )
        pieces = rest.split(".")
        if pieces[0].startswith("layer") and pieces[2][:4] in ("conv", "norm"):
            pieces[2] = f"convnormrelu{pieces[2][4:]}.{0 if pieces[2][:4] == 'conv' else 1}"
        return {"fnet": "feature_encoder", "cnet": "context_encoder"}[part] + "." + ".".join(pieces)
    if rest.startswith("encoder.conv"):
        kind, _, parameter = rest.removeprefix("encoder.").partition(".")
        kind = kind.replace("convc", "convcorr").replace("convf", "convflow") if kind != "conv" else kind
        return f"update_block.motion_encoder.{kind}.0.{parameter}"
    if rest.startswith("gru."):
        gate, parameter = rest.split(".")[1:]
        return f"update_block.recurrent_block.convgru{'1' if small else gate[-1]}.{gate if small else gate[:-1]}.{parameter}"
    if rest.startswith("mask."):
        return "mask_predictor." + rest.replace("mask.0", "convrelu.0").replace("mask.2", "conv")
    return name
