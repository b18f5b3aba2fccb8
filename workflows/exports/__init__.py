"""`e4dgs export` and `e4dgs render`."""
