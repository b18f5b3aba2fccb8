"""The scene's kernels for NVIDIA GPUs, compiled and launched as the rasterizer's are. Imported where a tensor lies on such a device."""
