"""The work of stage `flow` on the frames of a capture."""
