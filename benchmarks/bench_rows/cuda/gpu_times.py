"""How long a GPU is busy with a run, kernel by kernel."""

from __future__ import annotations

from collections.abc import Callable

import torch
from e4dgs.workflows.bench.cuda.gpu import CALLS


def gpu_times(run: Callable[[], object], calls: int = CALLS) -> dict[str, float]:
    """Seconds that the GPU spends in one call of `run`, by kernel (and copy), as torch's profiler sees it: without the host's time, and
    without gaps."""
    from torch.autograd import DeviceType
    from torch.profiler import ProfilerActivity, profile

    run()
    torch.cuda.synchronize()
    with profile(activities=[ProfilerActivity.CUDA], acc_events=True) as seen:
        for _ in range(calls):
            run()
        torch.cuda.synchronize()
    found = {
        event.key: 1e-6 * event.self_device_time_total / calls for event in seen.key_averages() if event.device_type == DeviceType.CUDA
    }
    return {key: seconds for key, seconds in found.items() if seconds}
