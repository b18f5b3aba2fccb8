"""The six-plane deformation field of the paper."""
