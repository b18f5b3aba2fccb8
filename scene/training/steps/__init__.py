"""A step: what it reads and finds, and how it is applied only if it is finite: checked at once on the CPU, deferred on a GPU."""
