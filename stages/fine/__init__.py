"""Stage `fine`: puts convexes in place of the chosen Gaussians, and refines both."""
