"""Where Gaussians begin: the work of `coarse` before it trains."""
