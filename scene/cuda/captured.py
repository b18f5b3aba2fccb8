"""Small networks as CUDA graphs: one replay for the host in place of every operation of the network."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from .graph import capturing
from .leaves import own_leaves

WARM_UP = 2  # runs before the capture, in which libraries take the memory that they keep


class Captured:
    """``function`` of a tensor like ``given``, differentiable in the parameters of ``module``, as one graph for its value and one for its
    gradients.

    function: maps a CUDA tensor to a tuple of float tensors. It must not wait for the device, and all that it reads besides ``given`` must
        stay where it is: the parameters are updated in place. Each of them must have a part in the result.

    Calls may follow one another before their backward passes: the graph of the gradients computes the value again.
    """

    def __init__(self, function: Callable[[Tensor], tuple[Tensor, ...]], module: nn.Module, given: Tensor) -> None:
        self.parameters = tuple(module.parameters())
        self.given = given.detach().clone()
        with own_leaves(module):
            self._capture(function, tuple(module.parameters()))
        self.sizes = [p.numel() for p in self.parameters]

    def _capture(self, function: Callable[[Tensor], tuple[Tensor, ...]], leaves: tuple[Tensor, ...]) -> None:
        def gradients(incoming: list[Tensor]) -> tuple[Tensor, ...]:
            with torch.enable_grad():
                return torch.autograd.grad(function(self.given), leaves, incoming)

        given = self.given
        here = torch.cuda.current_stream(given.device)
        aside = torch.cuda.Stream(given.device)
        aside.wait_stream(here)
        with torch.cuda.stream(aside):
            for _ in range(WARM_UP):
                gradients([torch.zeros_like(out) for out in function(given)])
        here.wait_stream(aside)
        self.forward, self.backward = torch.cuda.CUDAGraph(), torch.cuda.CUDAGraph()
        with torch.no_grad(), capturing(self.forward):
            self.results = function(given)
        self.incoming = [torch.zeros_like(result) for result in self.results]
        with capturing(self.backward):
            self.outgoing = torch.cat([gradient.flatten() for gradient in gradients(self.incoming)])

    def __call__(self, given: Tensor) -> tuple[Tensor, ...]:
        """``given`` may be on the CPU; it gets no gradient."""
        results: tuple[Tensor, ...] = _Replay.apply(self, given, *self.parameters)
        return results


class _Replay(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, captured: Captured, given: Tensor, *parameters: Tensor) -> tuple[Tensor, ...]:
        captured.given.copy_(given, non_blocking=True)
        captured.forward.replay()
        ctx.captured, ctx.given = captured, given
        ctx.set_materialize_grads(False)
        return tuple(result.clone() for result in captured.results)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor | None) -> tuple[Any, ...]:
        captured = ctx.captured
        captured.given.copy_(ctx.given, non_blocking=True)
        for incoming, grad in zip(captured.incoming, grads):
            incoming.zero_() if grad is None else incoming.copy_(grad)
        captured.backward.replay()
        parts = captured.outgoing.clone().split(captured.sizes)
        return None, None, *(part.view_as(p) for part, p in zip(parts, captured.parameters))
