"""How a model learns: the loop, its schedule, density control, the optimiser, and checkpoints."""
