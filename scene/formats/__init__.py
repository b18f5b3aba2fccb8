"""Exports splats and scenes to file formats that other programs read."""
