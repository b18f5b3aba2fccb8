"""The network that moves control nodes: a few courses through time that all nodes share, and their weights at each place."""

from __future__ import annotations

from itertools import pairwise

import torch
from torch import Tensor, nn

RANK = 32  # courses
OUTPUTS = 7  # of a node at a time: a turn (4) and a shift (3)
WIDTH, DEPTH = 128, 3  # of the layers that take places
TIME_WIDTH, TIME_DEPTH = 128, 2  # of the layers that take times: one row for each time, so they cost almost nothing
PLACE_BANDS, TIME_BANDS = 5, 6  # octaves of the positional encoding (Tancik et al. 2020)
LEAK = 0.01  # slope below zero: a unit that is zero everywhere gets no gradient, and the first steps can put all units in that state
HEADS = 1e-4  # standard deviation of the last layer's initial weights, so that motion grows from rest


class SharedCourses(nn.Module):
    """out(place, time) = sum over k of weights_k(place) course_k(time) / sqrt(RANK), where both factors are small networks.

    Objects move in few ways at once, so 32 courses are enough, as in non-rigid structure from motion (Bregler et al. 2000). A single
    network of (place, time) would be evaluated again for every node at every time. Here the places, which cost nearly all of it, are
    evaluated once for any number of times.

    Args:
        seed: of the initial weights.
    """

    def __init__(self, seed: int = 0) -> None:
        super().__init__()
        generator = torch.Generator().manual_seed(seed)
        place = layers([3 * (1 + 2 * PLACE_BANDS), *[WIDTH] * DEPTH, OUTPUTS * RANK], generator)
        time = layers([1 + 2 * TIME_BANDS, *[TIME_WIDTH] * TIME_DEPTH, RANK], generator)
        with torch.no_grad():
            place[-1].weight.normal_(0.0, HEADS, generator=generator)
        self.place, self.time = nn.ModuleList(place), nn.ModuleList(time)

    def forward(self, encoded: Tensor, times: Tensor) -> Tensor:
        """[T, B, 7] outputs at ``times`` [T] in [0, 1] of places [B, 33] as returned by `encode_places`."""
        courses = self.courses(times) * RANK**-0.5
        hidden, last = to_the_last(self.place, encoded), self.place[-1]
        assert isinstance(last, nn.Linear)
        # The courses go into the last layer before the places do: for a few times it is far smaller than the weights of all courses.
        # Not `matmul`, which rounds otherwise where there are gradients.
        heads = torch.bmm(courses.expand(OUTPUTS, -1, -1), last.weight.view(OUTPUTS, RANK, WIDTH)).transpose(0, 1).flatten(0, 1)
        biases = (courses @ last.bias.view(OUTPUTS, RANK).T).flatten()
        return torch.addmm(biases, hidden, heads.T).view(len(encoded), len(times), OUTPUTS).transpose(0, 1)

    def courses(self, times: Tensor) -> Tensor:
        """[T, RANK] courses at ``times`` [T] in [0, 1]."""
        return through(self.time, encode_times(times))


def encode_places(places: Tensor) -> Tensor:
    """Positional encoding [B, 33] of ``places`` [B, 3], scaled so that the scene spans about [-1, 1]."""
    return encode(places, PLACE_BANDS)


def encode_times(times: Tensor) -> Tensor:
    """Positional encoding [T, 13] of ``times`` [T] in [0, 1]."""
    return encode(times[:, None], TIME_BANDS)


def encode(x: Tensor, bands: int) -> Tensor:
    """``x`` [N, d] together with its sines and cosines at ``bands`` octaves: [N, d (1 + 2 bands)]."""
    scaled = x[:, None] * (2.0 ** torch.arange(bands, device=x.device, dtype=x.dtype))[:, None]
    return torch.cat([x, torch.sin(scaled).flatten(1), torch.cos(scaled).flatten(1)], 1)


def layers(sizes: list[int], generator: torch.Generator) -> list[nn.Linear]:
    """Linear layers initialised so that the scale of the activations is kept through ReLUs (He et al. 2015)."""
    layers = [nn.Linear(a, b) for a, b in pairwise(sizes)]
    with torch.no_grad():
        for layer in layers:
            bound = (6.0 / layer.in_features) ** 0.5
            layer.weight.uniform_(-bound, bound, generator=generator)
            layer.bias.zero_()
    return layers


def through(layers: nn.ModuleList, x: Tensor) -> Tensor:
    """``x`` [N, d] through ``layers``, with leaky ReLUs between them."""
    return layers[-1](to_the_last(layers, x))


def to_the_last(layers: nn.ModuleList, x: Tensor) -> Tensor:
    """What the last of ``layers`` takes, if ``x`` [N, d] goes through those before it."""
    for layer in layers[:-1]:
        x = nn.functional.leaky_relu(layer(x), LEAK)
    return x
