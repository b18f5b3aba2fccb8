"""Captures: recognises the format of a folder or file. `recognise(path) -> Capture`; each reader has its own file. See the DESIGN.md of
`stages`."""

from __future__ import annotations

from .capture import Capture
from .reading import Options, Shot, Video
from .recognise import FORMATS, Format, recognise

__all__ = ["FORMATS", "Capture", "Format", "Options", "Shot", "Video", "recognise"]
