"""LPIPS (Zhang et al. 2018): distance between normalised features of a trained network, weighted per channel.

AlexNet and VGG16 are implemented here up to their last convolution. Published weights are read from a safetensors file with
torchvision's names: "features.N.weight", "features.N.bias" and the linear heads "lin0.weight" to "lin4.weight", [1, C, 1, 1] each.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from .images import as_pair

Net = Literal["alex", "vgg"]
MINIMUM_SIZE = 32  # px; for smaller images AlexNet's last feature maps would be empty

# The layers of each trunk: ("conv", index, in, out, kernel, stride, padding), ("tap",) where features are compared, ("pool", kernel).
_ALEX: tuple[tuple, ...] = (
    ("conv", 0, 3, 64, 11, 4, 2),
    ("tap",),
    ("pool", 3),
    ("conv", 3, 64, 192, 5, 1, 2),
    ("tap",),
    ("pool", 3),
    ("conv", 6, 192, 384, 3, 1, 1),
    ("tap",),
    ("conv", 8, 384, 256, 3, 1, 1),
    ("tap",),
    ("conv", 10, 256, 256, 3, 1, 1),
    ("tap",),
)


def _vgg() -> tuple[tuple, ...]:
    layers: list[tuple] = []
    index, channels = 0, 3
    for block, (width, count) in enumerate(((64, 2), (128, 2), (256, 3), (512, 3), (512, 3))):
        if block:
            layers.append(("pool", 2))
            index += 1
        for _ in range(count):
            layers.append(("conv", index, channels, width, 3, 1, 1))
            index, channels = index + 2, width  # a ReLU follows each convolution
        layers.append(("tap",))
    return tuple(layers)


TRUNKS: dict[str, tuple[tuple, ...]] = {"alex": _ALEX, "vgg": _vgg()}

# Maps input in [-1, 1] to the statistics that the trunks were trained with.
_SHIFT = torch.tensor([-0.030, -0.088, -0.188]).view(1, 3, 1, 1)
_SCALE = torch.tensor([0.458, 0.448, 0.450]).view(1, 3, 1, 1)


def expected_shapes(net: Net) -> dict[str, tuple[int, ...]]:
    """Name and shape of every tensor that a weights file for ``net`` must hold."""
    shapes: dict[str, tuple[int, ...]] = {}
    taps, width = 0, 3
    for layer in TRUNKS[net]:
        if layer[0] == "conv":
            _, index, inside, width, kernel, _, _ = layer
            shapes[f"features.{index}.weight"] = (width, inside, kernel, kernel)
            shapes[f"features.{index}.bias"] = (width,)
        elif layer[0] == "tap":
            shapes[f"lin{taps}.weight"] = (1, width, 1, 1)
            taps += 1
    return shapes


class Lpips:
    """LPIPS with the given weights. ``state``: tensors by name, as `expected_shapes` lists them. Raises ValueError if they do not match."""

    def __init__(self, state: dict[str, Tensor], net: Net) -> None:
        for name, shape in expected_shapes(net).items():
            if name not in state:
                raise ValueError(f"LPIPS weights for {net}: tensor {name!r} is missing; is the file for another network?")
            if tuple(state[name].shape) != shape:
                raise ValueError(f"LPIPS weights for {net}: {name!r} is {list(state[name].shape)}, expected {list(shape)}")
            if not torch.isfinite(state[name]).all():
                raise ValueError(f"LPIPS weights for {net}: {name!r} holds non-finite values")
        self.net = net
        self.state = {name: state[name].detach().float() for name in expected_shapes(net)}

    @classmethod
    def load(cls, path: Path, net: Net) -> Lpips:
        """Read a safetensors file. Raises ValueError, naming the file, if it is missing or does not contain these weights."""
        from safetensors.torch import load_file

        try:
            return cls(load_file(path), net)
        except Exception as error:
            raise ValueError(f"{path}: {error}") from error

    def features(self, x: Tensor) -> list[Tensor]:
        """The five compared feature maps of ``x`` [1, 3, H, W] in [-1, 1]."""
        x = (x - _SHIFT) / _SCALE
        taps = []
        for layer in TRUNKS[self.net]:
            if layer[0] == "conv":
                _, i, _, _, _, stride, padding = layer
                weight, bias = self.state[f"features.{i}.weight"], self.state[f"features.{i}.bias"]
                x = F.relu(F.conv2d(x, weight, bias, stride=stride, padding=padding))
            elif layer[0] == "pool":
                x = F.max_pool2d(x, layer[1], stride=2)
            else:
                taps.append(x)
        return taps

    def __call__(self, image: np.ndarray, truth: np.ndarray) -> float:
        """Distance between two images, float [H, W, 3] in [0, 1], at least `MINIMUM_SIZE` px a side; 0 for identical images.

        Features are float32, as published; differences and means are float64.
        """
        image, truth = as_pair(image, truth)
        if min(image.shape[:2]) < MINIMUM_SIZE:
            raise ValueError(f"LPIPS needs images of at least {MINIMUM_SIZE} px a side, got {image.shape[1]}x{image.shape[0]}")
        total = 0.0
        with torch.no_grad():
            a, b = (self.features(torch.from_numpy(v * 2.0 - 1.0).float().permute(2, 0, 1)[None]) for v in (image, truth))
            for k, (fa, fb) in enumerate(zip(a, b)):
                difference = (_unit(fa.double()) - _unit(fb.double())).square()
                total += float((difference * self.state[f"lin{k}.weight"].double()).sum(1).mean())
        return total


def _unit(features: Tensor) -> Tensor:
    """Features [1, C, H, W] divided by their length over C."""
    return features / (features.square().sum(1, keepdim=True).sqrt() + 1e-10)
