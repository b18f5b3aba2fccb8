"""Primitives that are present for a time of their own."""
