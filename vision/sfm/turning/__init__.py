"""Cameras of a capture whose camera turns and hardly moves."""
