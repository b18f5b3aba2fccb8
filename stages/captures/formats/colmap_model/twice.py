"""A model that lies in one folder as binary and as text: only the binary one is read, as by COLMAP. Do the two say the same?"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .....pipeline import CaptureError
from .places import Model

_MOST_BYTES = 64 * 2**20  # of text that is read only to be compared
_PARTS = ("cameras", "images")
_NEAR = 1e-4  # text has often six or seven digits


def told_twice(model: Model) -> tuple[str, ...]:
    """A line if the model that is not read says something else, or cannot be compared."""
    place = model.place
    text = replace(place, suffix=".txt")
    files = [place.root / text.file(part) for part in _PARTS]
    if place.suffix == ".txt" or not all(file.is_file() for file in files):
        return ()
    both = f"{place.folder or 'the folder'} has its model as .bin, which is read, and as .txt, which is not"
    if sum(file.stat().st_size for file in files) > _MOST_BYTES:
        return (f"{both}; the text is too long to be compared",)
    try:
        difference = _difference(model, Model(text))
    except CaptureError as error:
        return (f"{both} and is damaged: {error}",)
    if difference is None:
        return ()
    return (f"{both}, and they disagree: {difference}; remove or rename the .bin files of this folder if the text is right",)


def _difference(model: Model, other: Model) -> str | None:
    """The first thing in which two models differ, in words."""
    own, others = ({image.name: image for image in one.images} for one in (model, other))
    if own.keys() != others.keys():
        lone = sorted(own.keys() ^ others.keys())[0]
        return f"{len(own)} images and {len(others)}; only one of them has {lone[:200]!r}"
    for name, image in own.items():
        if not np.allclose(image.pose, others[name].pose, rtol=_NEAR, atol=_NEAR) and not _opposite(image.pose, others[name].pose):
            return f"the poses of image {name[:200]!r} differ"
        camera, same = model.cameras.get(image.camera), other.cameras.get(others[name].camera)
        if camera is None or same is None:
            continue
        if camera[:3] != same[:3] or len(camera[3]) != len(same[3]) or not np.allclose(camera[3], same[3], rtol=_NEAR, atol=_NEAR):
            return f"the cameras of image {name[:200]!r} differ"
    return None


def _opposite(pose: np.ndarray, other: np.ndarray) -> bool:
    """Whether two quaternions of opposite sign, and a translation, are one pose."""
    return bool(np.allclose(pose, np.concatenate([-other[:4], other[4:]]), rtol=_NEAR, atol=_NEAR))
