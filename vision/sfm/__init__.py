"""Structure from motion with COLMAP, in a separate process. See DESIGN.md one folder up."""
