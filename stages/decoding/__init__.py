"""The work of stage `frames`: the capture's pictures are decoded, and what every frame is gets written down."""
