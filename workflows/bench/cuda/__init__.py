"""The CUDA kernels on one GPU: against the CPU path, against gsplat, and against what we promise of them."""
