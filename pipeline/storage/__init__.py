"""Artifacts and the store that keeps them."""
