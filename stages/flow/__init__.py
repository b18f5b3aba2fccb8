"""Stage `flow`: measures flow between frames, edge weights, and masks of what moves."""
