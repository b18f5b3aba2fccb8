"""Splats and scenes as the bytes of files that other programs read."""
