"""Features of images, found and matched, in a COLMAP database."""
