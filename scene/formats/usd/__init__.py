"""USD files, for film and effects: Gaussians over time, and the cameras of the capture."""
