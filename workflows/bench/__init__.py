"""`e4dgs bench`: run time against error, everything side by side on one machine. See workflows/DESIGN.md."""
