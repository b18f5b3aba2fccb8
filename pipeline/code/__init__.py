"""Digests of the source code that a stage's run reaches. They are part of the key, so a result of different code is never reused."""
