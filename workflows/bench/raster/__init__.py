"""Rows of `e4dgs bench raster`: one file a row, each with `measure`."""
