"""D-NeRF layout: `transforms_{train,val,test}.json`, `time` on every frame, RGBA images with straight alpha.

Each frame counts as a separate camera, unless fixed cameras saw several times, or the train poses form a smooth path. Then one camera
moved through the scene (a hand-held video exported in this layout), and neighbours in time form pairs.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ....pipeline import CaptureError
from .. import checks, keep_masks
from ..reading import SPLITS, TRAIN, Options, Reading, Shot
from . import transforms
from .cameras_of_times import fixed_cameras
from .frame_files import add_cloud, lost_depth, shot_of

_TRAIN = "transforms_train.json"
# Median step between train cameras consecutive in time, divided by the median distance of any two: 0.03 for a walked path of 90
# frames, 1.0 to 1.2 for the scattered views of D-NeRF. A straight walk of n frames has 3.4 / n, so a path needs about 14 frames.
_SMOOTH = 0.25


def detect(root: Path) -> str | None:
    return _TRAIN if (root / _TRAIN).is_file() else None


def read(root: Path, options: Options) -> Reading:
    files = [(i, f"transforms_{name}.json") for i, name in enumerate(SPLITS) if (root / f"transforms_{name}.json").is_file()]
    if detect(root) is None:
        raise CaptureError(f"{root}: no transforms_train.json, which the D-NeRF layout needs; pass its folder or another --format")
    loaded = [(split, file, checks.read_json(root, file)) for split, file in files]
    listed = {file: transforms.frames_of(data, file) for _, file, data in loaded}
    there = transforms.present(root, _TRAIN, listed)
    seen = [file for _, file in files]  # on which the result depends
    files = [(split, file) for split, file in files if there[file].paths]
    loaded = [one for one in loaded if there[one[1]].paths]
    listed = {file: listed[file] for _, file in files}
    entries = [(split, file, data, i, listed[file][i]) for split, file, data in loaded for i in there[file].paths]
    paths = [there[file].paths[i] for _, file, _, i, _ in entries]
    sizes, alpha = checks.image_headers(root, paths)

    per_file = [transforms.times_of(frames, file) for file, frames in listed.items()]
    if any(t is None for t in per_file) != all(t is None for t in per_file):
        bare = next(file for (_, file, _), t in zip(loaded, per_file, strict=True) if t is None)
        raise CaptureError(f"{bare}: frame 0: time is missing, but the other split files have times; add it, or remove it everywhere")
    times = [found[i] for found, file in zip(per_file, listed, strict=True) if found is not None for i in there[file].paths]
    timed, times = bool(times), times or [0.0] * len(entries)

    shots, said = [], list[str]()
    for number, ((split, file, data, i, frame), path, time, size) in enumerate(zip(entries, paths, times, sizes, strict=True)):
        where = f"{file}: frame {i}"
        shots.append(shot_of(root, frame, data, where, path, size, said, camera=(1, number), time=time, split=split))
    fixed = timed and fixed_cameras(shots)
    moving = not fixed and _join_path(shots)
    notes = [note for found in there.values() for note in found.notes] + said + list(lost_depth([entry[-1] for entry in entries], shots))
    if not timed and not options.static:
        notes.append(
            f"no frame of {' and '.join(file for _, file in files)} has a time, so all show one moment; add time if something moves"
        )
    if masked := keep_masks.told(root, shots, "(mask_path)"):
        notes.append(masked)
    raw_fps = loaded[0][2].get("fps")
    reading = Reading(
        why=" + ".join(file for _, file in files) + (", fixed cameras" if fixed else ", poses along one smooth path" if moving else ""),
        shots=shots,
        alpha=alpha,
        has_split=len(files) > 1,
        fps=None if raw_fps is None else checks.number(raw_fps, f"{files[0][1]}: fps", 1e-3, 1e6),
        fixed_cameras=fixed,
        sources=tuple(seen),
        notes=tuple(notes),
    )
    add_cloud(reading, root, loaded[0][2], files[0][1])
    return reading


def _join_path(shots: list[Shot]) -> bool:
    """Assigns one camera to the train shots if they form one path. Neighbours with a jump in between (a cut) stay unlinked. True if they
    form a path."""
    train = sorted((s for s in shots if s.split == TRAIN), key=lambda s: s.time)
    times = [s.time for s in train]
    if len(train) < 3 or len(set(times)) != len(times):
        return False
    centres = np.stack([checks.inverse(s.cam_from_world)[:3, 3] for s in train if s.cam_from_world is not None])
    steps = np.linalg.norm(np.diff(centres, axis=0), axis=1)
    some = centres[:: max(1, len(centres) // 500)]
    apart = np.linalg.norm(some[:, None] - some[None], axis=-1)[np.triu_indices(len(some), 1)]
    limit = _SMOOTH * float(np.median(apart))
    if np.median(steps) > limit:
        return False
    for shot, step in zip(train, [*steps, 0.0], strict=True):
        shot.camera = (0, 0)
        shot.linked = bool(step <= limit)
    return True
