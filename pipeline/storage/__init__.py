"""Artifacts, and the store that holds them."""
