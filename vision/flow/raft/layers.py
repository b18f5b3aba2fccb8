"""RAFT's three parts as functions, built from convolutions that take their weights by name from a dictionary."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor
from torch.nn import functional as F

from .architecture import Architecture, blocks, passes

State = Mapping[str, Tensor]


def convolution(state: State, name: str, x: Tensor, stride: int = 1) -> Tensor:
    """Convolves x [B, C, H, W] with the weights `name`, padded by half the kernel."""
    weight = state[f"{name}.weight"]
    return F.conv2d(x, weight, state.get(f"{name}.bias"), stride=stride, padding=(weight.shape[2] // 2, weight.shape[3] // 2))


def encode(state: State, encoder: str, a: Architecture, x: Tensor) -> Tensor:
    """Features [B, C, H/8, W/8] of pictures x [B, 3, H, W] in [-1, 1]. encoder: "fnet" (instance norm per picture) or "cnet"."""
    per_picture = encoder == "fnet"

    def step(name: str, x: Tensor, stride: int = 1) -> Tensor:
        x = convolution(state, f"{encoder}.{name}", x, stride)
        # In place where nothing else reads it: these are the largest tensors of the network.
        return F.instance_norm(x) if per_picture else x

    x = step("conv1", x, 2).relu_()
    for name, _, _, stride in blocks(a):
        if a.small:
            y = step(f"{name}.conv1", x).relu_()
            y = step(f"{name}.conv2", y, stride).relu_()
            y = step(f"{name}.conv3", y).relu_()
        else:
            y = step(f"{name}.conv1", x, stride).relu_()
            y = step(f"{name}.conv2", y).relu_()
        if stride > 1:
            x = step(f"{name}.downsample.0", x, stride)
        x = y.add_(x).relu_()
    return convolution(state, f"{encoder}.conv2", x)


def context_terms(state: State, a: Architecture, context: Tensor) -> list[Tensor]:
    """What the context [B, C, h, w] adds to z, r and q of each pass, [B, 3 state, h, w]. It is the same at every step, so computed once."""
    return [convolution(state, f"gru.context{k}", context) for k in passes(a)]


def update(state: State, a: Architecture, hidden: Tensor, terms: list[Tensor], correlation: Tensor, flow: Tensor) -> tuple[Tensor, Tensor]:
    """One step of the recurrent unit, all [B, C, h, w]. Returns the new hidden state and the change of the flow [B, 2, h, w] (in features).

    terms: from `context_terms`. state: from `weights.folded`.
    """
    at = "update_block.encoder"
    matched = convolution(state, f"{at}.convc1", correlation).relu_()
    if not a.small:
        matched = convolution(state, f"{at}.convc2", matched).relu_()
    moved = convolution(state, f"{at}.convf1", flow).relu_()
    moved = convolution(state, f"{at}.convf2", moved).relu_()
    motion = convolution(state, f"{at}.conv", torch.cat([matched, moved], 1)).relu_()
    for k, term in zip(passes(a), terms):
        gates = convolution(state, f"gru.gates{k}", torch.cat([hidden, motion, flow], 1))
        z, r = gates.add_(term[:, : 2 * a.state]).sigmoid_().chunk(2, 1)
        q = convolution(state, f"gru.state{k}", torch.cat([r * hidden, motion, flow], 1)).add_(term[:, 2 * a.state :]).tanh_()
        hidden = torch.lerp(hidden, q, z)
    step = convolution(state, "update_block.flow_head.conv1", hidden).relu_()
    return hidden, convolution(state, "update_block.flow_head.conv2", step)


def enlarge(state: State, a: Architecture, hidden: Tensor, flow: Tensor) -> Tensor:
    """Upsamples flow [B, 2, h, w] in features to [B, 2, 8h, 8w] in px. Each pixel is a learned convex combination of the nine features
    around it; the small network interpolates bilinearly."""
    if a.small:
        return 8 * F.interpolate(flow, scale_factor=8, mode="bilinear", align_corners=True)
    b, _, h, w = flow.shape
    logits = convolution(state, "update_block.mask.2", convolution(state, "update_block.mask.0", hidden).relu_())
    weights = (0.25 * logits).view(b, 1, 9, 8, 8, h, w).softmax(2)
    around = F.unfold(8 * flow, 3, padding=1).view(b, 2, 9, 1, 1, h, w)
    fine = (weights * around).sum(2)  # [B, 2, 8, 8, h, w]
    return fine.permute(0, 1, 4, 2, 5, 3).reshape(b, 2, 8 * h, 8 * w)
