"""One reader for each kind of capture."""
