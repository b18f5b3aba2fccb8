"""Optical flow between two pictures, and how far it can be trusted."""
