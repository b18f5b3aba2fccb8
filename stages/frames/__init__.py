"""Stage `frames`: reads the metadata of every frame of a capture, checks its pictures and decodes its videos."""
