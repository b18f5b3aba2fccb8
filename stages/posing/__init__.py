"""The work of stage `poses` on the frames of a capture."""
