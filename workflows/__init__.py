"""See DESIGN.md in this folder."""
