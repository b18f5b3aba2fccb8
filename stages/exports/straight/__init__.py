"""Models as Gaussians on straight paths, in pieces: what open 4D formats hold."""
