"""`e4dgs bench`: measures whether this machine is as fast as it should be. See workflows/DESIGN.md."""
