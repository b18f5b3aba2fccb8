"""What is added and removed while a model learns: primitives, and parts of the motion."""
