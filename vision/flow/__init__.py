"""Optical flow of two pictures, and how far it may be trusted."""
