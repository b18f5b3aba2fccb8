"""Frames of a rig in a COLMAP model (3.12 and later): which pictures its cameras took at one time."""

from __future__ import annotations

import posixpath
import re
from collections.abc import Sequence

from .....pipeline import counted
from ... import checks
from ...listing.numbers import places, set_times
from ...reading import Shot
from ...rigs import Placed
from .places import Model
from .records import FrameRecord, ImageRecord


def place_frames(model: Model, images: Sequence[ImageRecord], shots: Sequence[Shot]) -> tuple[Placed | None, str | None]:
    """Sets camera and time of each of ``shots``, of ``images``, if the model's frames tell them; and a line if they cannot be followed.

    Frames with one image each, which every model has, tell nothing: (None, None)."""
    if all(len(frame.images) < 2 for frame in model.frames):
        return None, None
    file = model.place.file("frames")
    found = {number: frame for frame in model.frames for number in frame.images.values()}
    lost = [image.name for image in images if image.number not in found]
    if lost:
        told = f"{counted(len(lost), 'image')} of the model (first {lost[0]}) {'is' if len(lost) == 1 else 'are'} in none of its frames"
        return None, f"{file} is not followed: {told}; times follow the names of the pictures"
    of_image = [found[image.number] for image in images]
    rigs = len({frame.rig for frame in of_image})
    if rigs > 1:
        return (
            None,
            f"{file} is not followed: its frames are of {rigs} rigs, and it gives no common times; times follow the names of the pictures",
        )
    clock, gaps, skipped = _clock(list(zip(of_image, images, strict=True)))
    for shot, image in zip(shots, images, strict=True):
        shot.camera = image.camera
    set_times(shots, [clock[frame.number] for frame in of_image], gaps)
    cameras = len({image.camera for image in images})
    note = f"{file}: pictures of one frame of the rig show one time ({counted(cameras, 'camera')}, {counted(len(clock), 'frame')})"
    return Placed(cameras > 1, (note, *([skipped] if skipped else ()))), None


def _clock(pairs: Sequence[tuple[FrameRecord, ImageRecord]]) -> tuple[dict[int, int], bool, str | None]:
    """(place of each frame's time, whether times passed between them, a line for people), from the names of the frames' pictures."""
    names: dict[int, list[str]] = {}
    for frame, image in pairs:
        names.setdefault(frame.number, []).append(posixpath.basename(image.name.replace("\\", "/")))
    order = sorted(names, key=lambda number: min(_digits(name) for name in names[number])) if not _rising(pairs) else sorted(names)
    stems = [{posixpath.splitext(name)[0] for name in names[number]} for number in order]
    if any(len(stem) > 1 for stem in stems):  # the cameras count on their own
        return {number: k for k, number in enumerate(order)}, False, None
    clock, told = places([f"{stem.pop()}.png" for stem in stems])
    return dict(zip(order, clock, strict=True)), clock[-1] >= len(clock), told


def _rising(pairs: Sequence[tuple[FrameRecord, ImageRecord]]) -> bool:
    """Whether the numbers of frames rise with the names of each camera's pictures."""
    of_camera: dict[int, list[int]] = {}
    for frame, image in sorted(pairs, key=lambda pair: checks.natural_key(pair[1].name)):
        of_camera.setdefault(image.camera, []).append(frame.number)
    return all(numbers == sorted(numbers) for numbers in of_camera.values())


def _digits(name: str) -> list[int]:
    return [int(text) for text in re.findall("[0-9]+", posixpath.splitext(name)[0])]
