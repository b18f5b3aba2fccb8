"""The machine and the process in which a command runs."""
