"""What the rows of this suite share: a scene on the GPU, runs that end when the GPU has, and the memory that a run takes."""

from __future__ import annotations

from collections.abc import Callable

import torch

from ....pipeline import SettingsError
from ....rasterizer import rasterize
from ....rasterizer.reference.scene import Scene
from ...machine.devices import why_not_cuda
from ..render import Rasterize, both

CALLS = 10  # of what is timed, in one run


def need_gpu() -> None:
    """Raises SettingsError, with the reason, where there is no GPU to measure on."""
    if not torch.cuda.is_available():
        raise SettingsError(f"bench cuda: {why_not_cuda() or 'torch finds no GPU'}; there is nothing to measure on")


def on_gpu(scene: Scene) -> Scene:
    """Its primitives on the GPU; camera and background stay on the CPU, as training has them."""
    return scene.having({name: value.cuda() for name, value in scene.tensors().items() if "." in name})


def ending(run: Callable[[], object], calls: int = CALLS) -> Callable[[], None]:
    """`calls` calls, then a wait for the GPU."""

    def whole() -> None:
        for _ in range(calls):
            run()
        torch.cuda.synchronize()

    return whole


def both_on_gpu(scene: Scene, with_: Rasterize = rasterize) -> Callable[[], object]:
    """`both` of a scene that is there."""
    with torch.device("cuda"):
        return both(scene, with_)


def peak_mib(run: Callable[[], object]) -> float:
    """MiB of torch's allocator at the run's peak, beyond what was there before it."""
    run()
    torch.cuda.synchronize()
    before = torch.cuda.memory_allocated()
    torch.cuda.reset_peak_memory_stats()
    run()
    torch.cuda.synchronize()
    return (torch.cuda.max_memory_allocated() - before) / 2**20


def gpu_name() -> str:
    """Name, driver's CUDA version and torch's, for protocols."""
    return f"{torch.cuda.get_device_name(0)}, torch {torch.__version__}"
