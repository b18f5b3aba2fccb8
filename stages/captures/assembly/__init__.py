"""From what a reader found to a `Capture`: times and splits, one size for all pictures, poses near the origin."""
