"""Captures that nobody should give e4dgs, and the referee that watches what it does with them."""
