"""The parts of `pretend_cuda`: the tensor that says it lies on a GPU, what CUDA lets tensors of two devices do, and what waits for it."""
