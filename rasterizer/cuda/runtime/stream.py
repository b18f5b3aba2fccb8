"""The stream that torch queues work on."""

from __future__ import annotations

import torch


def _stream_object(index: int) -> int:
    return int(torch.cuda.current_stream(index).cuda_stream)


# The current stream's handle, of the device with this index. torch's own code and Triton ask like this, without making an object for it.
current_stream = getattr(torch._C, "_cuda_getCurrentRawStream", _stream_object)
