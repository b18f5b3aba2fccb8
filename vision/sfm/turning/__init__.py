"""Finds the cameras of a capture whose camera turns but hardly moves."""
