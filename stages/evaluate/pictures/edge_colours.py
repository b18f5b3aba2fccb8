"""The colours in which the edges of a render and of the ground truth are drawn. Imports nothing heavy: the report's legend uses them."""

BOTH, MISSING, ADDED = (205, 210, 215), (77, 163, 255), (255, 140, 46)  # distinguishable with red-green colour blindness
KEYS = ((BOTH, "in both"), (MISSING, "only in the ground truth"), (ADDED, "only in the render"))
