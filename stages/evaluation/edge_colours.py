"""The colours in which the edges of a render and of the ground truth are drawn. The report's legend needs them, and nothing heavy."""

BOTH, MISSING, ADDED = (205, 210, 215), (77, 163, 255), (255, 140, 46)  # told apart by eyes that see no red or green, too
KEYS = ((BOTH, "in both"), (MISSING, "only in the ground truth"), (ADDED, "only in the render"))
