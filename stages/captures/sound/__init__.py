"""Aligns the clocks of several videos of one event by their sound."""
