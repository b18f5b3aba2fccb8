"""What moves primitives: one face (`interface.py`) and its implementations."""
