"""A stage's use of the machine: threads and memory."""
