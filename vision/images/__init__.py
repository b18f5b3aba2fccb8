"""Picture files, lens distortion, and pictures and movies for people to look at."""
