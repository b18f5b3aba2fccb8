"""Poses of the frames between those that structure from motion used."""
