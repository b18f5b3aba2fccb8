"""Stage `depth`: depth of single frames, from the capture's files or from a network, aligned to the poses' known points."""
