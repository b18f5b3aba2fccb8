"""The scene's kernels for NVIDIA GPUs, compiled and launched like those of the rasterizer. Imported only when a tensor is on one."""
