"""Stage `coarse`: trains Gaussians to represent the scene's shape and motion."""
