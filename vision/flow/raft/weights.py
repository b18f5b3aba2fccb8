"""Reads RAFT's published weights from a file, under the authors' or torchvision's tensor names. Any other set of tensors is refused."""

from __future__ import annotations

import pickle
import re
from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor

from .architecture import BASIC, SMALL, Architecture, expected_shapes, norms, passes

LARGEST_FILE = 256 << 20  # bytes; the basic network has 21 MB
EPSILON = 1e-5  # of the batch norms, as in training
# Translates torchvision's names to the authors', piece by piece. torchvision numbers the layers of a block: convolution, norm, ReLU.
_TORCHVISION = (
    (r"^feature_encoder\.", "fnet."),
    (r"^context_encoder\.", "cnet."),
    (r"^(fnet|cnet)\.convnormrelu\.0\.", r"\1.conv1."),
    (r"^(fnet|cnet)\.convnormrelu\.1\.", r"\1.norm1."),
    (r"^(fnet|cnet)\.conv\.", r"\1.conv2."),
    (r"\.convnormrelu(\d)\.0\.", r".conv\1."),
    (r"\.convnormrelu(\d)\.1\.", r".norm\1."),
    (r"^update_block\.motion_encoder\.convcorr(\d)\.0\.", r"update_block.encoder.convc\1."),
    (r"^update_block\.motion_encoder\.convflow(\d)\.0\.", r"update_block.encoder.convf\1."),
    (r"^update_block\.motion_encoder\.conv\.0\.", "update_block.encoder.conv."),
    (r"^update_block\.recurrent_block\.convgru(\d)\.conv([zrq])\.", r"update_block.gru.conv\2\1."),
    (r"^mask_predictor\.convrelu\.0\.", "update_block.mask.0."),
    (r"^mask_predictor\.conv\.", "update_block.mask.2."),
)


def read_weights(path: Path) -> tuple[dict[str, Tensor], Architecture]:
    """Tensors and the network they belong to, from a safetensors file or a `.pth` of plain tensors (nothing else in it is loaded or run).

    Raises ValueError that names the file and what is wrong with it: missing, cut short, another network, a value that is not finite.
    """
    try:
        if not path.is_file():
            raise ValueError("no such file")
        if path.stat().st_size > LARGEST_FILE:
            raise ValueError(f"larger than {LARGEST_FILE >> 20} MiB: not RAFT's weights")
        return recognise(_tensors(path))
    except ValueError as error:
        raise ValueError(f"RAFT weights {path}: {error}") from error


def _tensors(path: Path) -> dict[str, Tensor]:
    try:
        if path.suffix == ".safetensors":
            from safetensors.torch import load_file

            loaded = load_file(path)
        else:
            loaded = torch.load(path, map_location="cpu", weights_only=True)
    except pickle.UnpicklingError as error:
        raise ValueError("holds more than tensors, which is never loaded; save its state_dict as safetensors") from error
    except Exception as error:  # cut short, another format: each library raises its own errors
        raise ValueError(
            f"cannot be read, {type(error).__name__}: {str(error).splitlines()[0] if str(error) else 'no reason given'}"
        ) from error
    if not isinstance(loaded, Mapping) or not all(isinstance(k, str) and isinstance(v, Tensor) for k, v in loaded.items()):
        raise ValueError("expected tensors by name (a state_dict)")
    return dict(loaded)


def recognise(tensors: Mapping[str, Tensor]) -> tuple[dict[str, Tensor], Architecture]:
    """The tensors that the network needs, float32, under the authors' names, and which network it is. Raises ValueError for other sets."""
    named = {}
    for name, value in tensors.items():
        name = name.removeprefix("module.")
        for pattern, replacement in _TORCHVISION:
            name = re.sub(pattern, replacement, name)
        # Left out: counters, and a second copy of the shortcuts' norms.
        if not name.endswith("num_batches_tracked") and not re.search(r"layer[23]\.0\.norm[34]\.", name):
            named[name] = value
    # Only the small network's blocks have three convolutions.
    small = "fnet.layer1.0.conv3.weight" in named
    architecture = SMALL if small else BASIC
    if small and "update_block.gru.convz1.weight" in named:  # torchvision numbers the pass even if there is only one
        named = {re.sub(r"(gru\.conv[zrq])1\.", r"\1.", name): value for name, value in named.items()}
    expected = expected_shapes(architecture)
    for name, shape in expected.items():
        if name not in named:
            raise ValueError(f"tensor {name!r} is missing; expected the weights of RAFT, basic or small")
        if tuple(named[name].shape) != shape:
            raise ValueError(f"{name!r} is {list(named[name].shape)}, expected {list(shape)} for {architecture.name}")
        if not named[name].is_floating_point() or not torch.isfinite(named[name]).all():
            raise ValueError(f"{name!r} holds values that are not finite numbers")
    unknown = sorted(named.keys() - expected.keys())
    if unknown:
        raise ValueError(f"tensor {unknown[0]!r} is not part of {architecture.name}: weights of another network")
    return {name: named[name].detach().float() for name in expected}, architecture


def _of_norm(name: str) -> bool:
    return ".norm" in name or ".downsample.1." in name


def folded(state: Mapping[str, Tensor], architecture: Architecture) -> dict[str, Tensor]:
    """The weights that the network computes with. Each batch norm is fixed after training and is folded into the convolution before it.

    The recurrent unit's convolutions are split and joined by what they read. "gru.gates" (z and r) and "gru.state" (q) read the hidden
    state and the motion. "gru.context" is the part of all three that reads the context, with their biases.
    """
    found = {name: value for name, value in state.items() if not name.startswith("update_block.gru.") and not _of_norm(name)}
    for norm, convolution in norms(architecture).items():
        scale = state[f"{norm}.weight"] / (state[f"{norm}.running_var"] + EPSILON).sqrt()
        found[f"{convolution}.weight"] = state[f"{convolution}.weight"] * scale[:, None, None, None]
        found[f"{convolution}.bias"] = (state[f"{convolution}.bias"] - state[f"{norm}.running_mean"]) * scale + state[f"{norm}.bias"]
    begin, end = architecture.state, architecture.state + architecture.context  # inputs: hidden state, context, motion
    for k in passes(architecture):
        z, r, q = (state[f"update_block.gru.conv{gate}{k}.weight"] for gate in "zrq")
        others = [torch.cat([weight[:, :begin], weight[:, end:]], 1) for weight in (z, r, q)]
        found[f"gru.gates{k}.weight"], found[f"gru.state{k}.weight"] = torch.cat(others[:2]), others[2]
        found[f"gru.context{k}.weight"] = torch.cat([weight[:, begin:end] for weight in (z, r, q)])
        found[f"gru.context{k}.bias"] = torch.cat([state[f"update_block.gru.conv{gate}{k}.bias"] for gate in "zrq"])
    return found
