"""Rows of the suite raster: one file a row, each with `measure`."""
