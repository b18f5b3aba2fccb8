"""Stage `frames`: metadata of every frame (time, camera, split, pose), and the decoded pictures of videos.

Image files are checked by decoding each one once, and are not copied. Videos are decoded frame by frame into the artifact, so memory
stays bounded. docs/artifacts.md documents the arrays and attributes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ...pipeline import Applies, Context, Given, Resources, Stage, counted
from ..captures import Capture
from ..facts import Facts
from .settings import FramesSettings, recognise_for
from .videos import video_parts


class Frames(Stage):
    name = "frames"
    items = "cameras"
    inputs = ()
    settings = FramesSettings
    reads_capture = True

    def applies(self, facts: Mapping[str, Any], settings: FramesSettings) -> Applies:
        known = Facts.of(facts)
        action = "pictures stay in their files" if known.images_in_files else "pictures are decoded from video"
        return Applies.yes(f"{counted(known.frames, 'frame')}, {action}")

    def estimate(self, facts: Mapping[str, Any], settings: FramesSettings) -> float | None:
        """Decoding once on two cores: about 60 megapixels per second from image files, 15 from video into the store (measured)."""
        known = Facts.of(facts)
        new = (known.cameras if known.new_items is None else known.new_items) / known.cameras
        megapixels = new * known.frames * known.width * known.height / 1e6
        return 0.5 + megapixels / (60 if known.images_in_files else 15)

    def item_parts(self, given: Given) -> Sequence[Any]:
        """The videos, each of which is a camera; [] if the pictures are image files."""
        capture = _recognised(given)
        return video_parts(capture, given) if capture.images is None else []

    def resources(self, facts: Mapping[str, Any], settings: FramesSettings, device: str) -> Resources:
        from ..estimates import picture_resources

        return picture_resources(Facts.of(facts), 0.3)

    def run(self, ctx: Context) -> None:
        from .run import decode_capture

        decode_capture(_recognised(ctx), ctx)


def _recognised(given: Given | Context) -> Capture:
    return given.capture if isinstance(given.capture, Capture) else recognise_for(given.capture.root, given.settings)  # type: ignore[arg-type]
