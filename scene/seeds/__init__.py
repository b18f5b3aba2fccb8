"""Where Gaussians begin when the capture brings few points or none: one way to find them a file."""
