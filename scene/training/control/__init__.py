"""What comes and goes while a model learns: primitives, and parts of the motion."""
