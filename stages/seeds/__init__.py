"""Initial Gaussians: the work of `coarse` before training."""
