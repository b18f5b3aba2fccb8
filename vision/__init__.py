"""Turns pictures into optical flow, edges, masks of moving pixels, and camera poses. See DESIGN.md in this folder."""
