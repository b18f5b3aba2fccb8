"""Files of a capture by their names alone: what kinds they are, in which order they come, and which of them nothing reads."""
