"""Depth of pictures: read from files, or from a network, and aligned to known points."""
