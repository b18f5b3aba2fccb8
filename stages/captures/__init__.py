"""Captures: recognising what a folder or file holds. `recognise(path) -> Capture`; one reader a file. See DESIGN.md of `stages`."""

from __future__ import annotations

from .capture import Capture, Options, Shot, Video
from .recognise import FORMATS, recognise

__all__ = ["FORMATS", "Capture", "Options", "Shot", "Video", "recognise"]
