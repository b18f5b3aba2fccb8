"""Sphinx builds the documentation: `python3 dev.py docs`."""

import re
from typing import Any

project = "e4dgs"
copyright = "the e4dgs authors"
extensions = ["myst_parser"]
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3
html_theme = "furo"
html_title = "e4dgs"
exclude_patterns: list[str] = []


def link_to_files(app: Any, page: str, source: list[str]) -> None:
    """Pages of the repository that are not part of the site are offered as files."""
    source[0] = re.sub(r"\]\((\.\./[\w/.-]+\.md)(#[\w-]+)?\)", r"](path:\1)", source[0])


def setup(app: Any) -> None:
    app.connect("source-read", link_to_files)
