"""The machine and the process that a command runs in."""
