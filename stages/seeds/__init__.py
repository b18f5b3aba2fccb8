"""Stage `seeds`: places where Gaussians begin, with depth maps of what is static."""
