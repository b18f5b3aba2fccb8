"""Several cameras without poses: builds the request for structure from motion, and maps its result to the capture's frames. This code runs
in the parent process."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from ...pipeline.choice.evenly import evenly
from ...pipeline.files import written_beside
from ...vision.images.pictures import size_within
from ...vision.moving.motion_mask import SAMPLES, motion_mask
from ...vision.sequences import camera_sequences
from ...vision.sfm.fixed_cameras import is_fixed
from ...vision.sfm.looks import Looks, choose_looks, expand
from ..shared.frameset import FrameSet

MASK_SIZE = 480  # px, longest side at which moving pixels are detected
GROW = 3  # px at that size by which masks grow: features lie on outlines, and their windows reach beyond


@dataclass(frozen=True)
class Several:
    """looks: the pictures that are used. request: the corresponding parts of the worker's request. told: a sentence for people."""

    looks: Looks
    request: dict[str, Any]
    told: str

    def of_frames(self, frames: FrameSet, arrays: Mapping[str, np.ndarray], facts: Mapping[str, Any]) -> tuple[dict[str, np.ndarray], dict]:
        """Converts arrays and facts of the worker's images to those of the capture's frames."""
        expanded = expand(arrays, self.looks.image_of_frame)
        features = [facts["features"][i] for i in self.looks.image_of_frame]
        poor = [mine[0] for mine in camera_sequences(frames.camera, frames.time).values() if not expanded["registered"][mine].any()]
        notes = list(facts["notes"])
        if poor:
            notes.append(
                f"no frame of {', '.join(_video(frames, i) for i in poor)} has a pose: it shares too little with the others; "
                "put a camera between them, or take the video out"
            )
        return expanded, {**facts, "features": features, "notes": notes}


def several_cameras(
    frames: FrameSet, folder: Path, matcher: str | None, overlap: int, write: Callable[[int], str], advance: Callable[[], None]
) -> Several:
    """Finds the cameras that stand still, chooses the pictures to use, and writes them.

    write(i): writes the picture of frame i and returns its name. advance: called after each camera. Masks of moving pixels of the cameras
    that stand still are written to `folder`.
    """
    sequences = camera_sequences(frames.camera, frames.time)
    fixed = {}
    for camera, mine in sequences.items():
        fixed[camera] = is_fixed(frames.original, mine)
        advance()
    looks = choose_looks(frames.camera, frames.time, fixed, matcher, overlap)
    count, names = len(sequences), sorted({_video(frames, sequences[c][0]) for c in looks.fixed})
    if not names:
        told = f"all of the {count} cameras move"
    elif looks.all_fixed:
        told = f"all of the {count} cameras stand still: one pose each, from pictures at {len(looks.frames) // count} times"
    else:
        told = f"of {count} cameras {', '.join(names)} {'stand' if len(names) > 1 else 'stands'} still: one pose each"
    image = looks.image
    request: dict[str, Any] = {"names": [write(i) for i in looks.frames], "pairs": looks.pairs}
    if not looks.fixed:
        return Several(looks, {**request, "cameras": [int(frames.camera[i]) for i in looks.frames]}, told)
    masks = folder / "fixed.npz"
    if not masks.exists():
        _write_masks(frames, sequences, looks, masks)
    request |= {
        "task": "reconstruct_rig",
        "images": image,
        "cameras": [int(frames.camera[looks.frames[image.index(i)]]) for i in range(max(image) + 1)],
        "all_fixed": looks.all_fixed,
        "masks": str(masks),
    }
    return Several(looks, request, told)


def _write_masks(frames: FrameSet, sequences: Mapping[int, Sequence[int]], looks: Looks, file: Path) -> None:
    width, height = size_within(frames.width, frames.height, MASK_SIZE)
    masks = np.zeros((max(looks.image) + 1, height, width), bool)
    for camera in looks.fixed:
        mine = sequences[camera]
        seen = [i for i in looks.frames if frames.camera[i] == camera]

        def load(i: int) -> np.ndarray:
            return np.asarray(cv2.resize(frames.original(i), (width, height), interpolation=cv2.INTER_AREA))

        masks[looks.image_of_frame[mine[0]]] = motion_mask(load, sorted({*evenly(mine, SAMPLES), *seen}), GROW) > 0
    with written_beside(file) as part:
        np.savez_compressed(part, allow_pickle=False, masks=masks)


def _video(frames: FrameSet, i: int) -> str:
    return frames.names[i].rpartition("#")[0] or frames.names[i]
