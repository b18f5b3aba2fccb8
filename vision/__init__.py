"""Pictures in; optical flow, edges, what moves, and poses out. See DESIGN.md in this folder."""
