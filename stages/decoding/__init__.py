"""The work of stage `frames`: decodes the capture's pictures and writes the metadata of every frame."""
