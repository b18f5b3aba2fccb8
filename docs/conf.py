"""Sphinx builds the documentation: `python3 dev.py docs`."""

project = "e4dgs"
copyright = "the e4dgs authors"
extensions = ["myst_parser"]
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3
html_theme = "furo"
html_title = "e4dgs"
exclude_patterns: list[str] = []
