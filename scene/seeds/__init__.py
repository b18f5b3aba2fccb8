"""Where Gaussians start when the capture has few or no points. Each file has one method."""
