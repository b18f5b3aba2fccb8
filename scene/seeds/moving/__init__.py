"""Seeds on what moves, from several cameras that see one time."""
