"""Helpers of this suite: scenes on the GPU, runs that wait for the GPU, and the peak memory of a run."""

from __future__ import annotations

from collections.abc import Callable

import torch

from ....pipeline import SettingsError
from ....rasterizer import rasterize
from ....rasterizer.reference.scene import Scene
from ...machine.devices import why_not_cuda
from ..render import Rasterize, both

CALLS = 10  # of the timed function in one run


def need_gpu() -> None:
    """Raises SettingsError with the reason if there is no GPU to measure on."""
    if not torch.cuda.is_available():
        raise SettingsError(f"bench cuda: {why_not_cuda() or 'torch finds no GPU'}; there is nothing to measure on")


def on_gpu(scene: Scene) -> Scene:
    """The scene with its primitives on the GPU; camera and background stay on the CPU, as in training."""
    return scene.having({name: value.cuda() for name, value in scene.tensors().items() if "." in name})


def ending(run: Callable[[], object], calls: int = CALLS) -> Callable[[], None]:
    """A function that calls `run` `calls` times and then waits for the GPU."""

    def whole() -> None:
        for _ in range(calls):
            run()
        torch.cuda.synchronize()

    return whole


def both_on_gpu(scene: Scene, with_: Rasterize = rasterize) -> Callable[[], object]:
    """`render.both` for a scene on the GPU."""
    with torch.device("cuda"):
        return both(scene, with_)


def peak_mib(run: Callable[[], object]) -> float:
    """Peak memory of a run in torch's allocator, MiB, without what was allocated before."""
    run()
    torch.cuda.synchronize()
    before = torch.cuda.memory_allocated()
    torch.cuda.reset_peak_memory_stats()
    run()
    torch.cuda.synchronize()
    return (torch.cuda.max_memory_allocated() - before) / 2**20


def gpu_name() -> str:
    """Name of the GPU and version of torch, for protocols."""
    return f"{torch.cuda.get_device_name(0)}, torch {torch.__version__}"
