"""Picture files, lenses, and pictures for people."""
