"""One `transforms.json` (nerfstudio, instant-ngp): a moving camera, or several cameras if times repeat."""

from __future__ import annotations

import posixpath
from pathlib import Path
from typing import Any

from ....pipeline import CaptureError, counted
from ....pipeline.names import composed
from .. import checks, keep_masks
from ..listing.numbers import SPLIT_WORDS
from ..posed.finding import left_out
from ..posed.timestamps import timestamps
from ..reading import SPLITS, TEST, TRAIN, Options, Reading
from ..rigs import Placed, place_untimed
from . import transforms
from .cameras_of_times import fixed_cameras, moving_cameras
from .frame_files import add_cloud, lost_depth, shot_of

_FILE = "transforms.json"


def detect(root: Path) -> str | None:
    return _FILE if (root / _FILE).is_file() else None


def read(root: Path, options: Options) -> Reading:
    if detect(root) is None:
        raise CaptureError(f"{root}: no {_FILE}, which the nerfstudio layout needs; pass its folder or another --format")
    data = checks.read_json(root, _FILE)
    frames, held_out = transforms.frames_of(data, _FILE), _test_frames(data)
    places = [*(f"{_FILE}: frame {i}" for i in range(len(frames))), *(f"{_FILE}: test_frames[{i}]" for i in range(len(held_out)))]
    frames = [*frames, *held_out]
    found = transforms.present(root, _FILE, {_FILE: frames})[_FILE]
    good = {i: path for i, path in found.paths.items() if frames[i].get("is_bad") is not True}
    if not good:
        raise CaptureError(f"{_FILE}: each frame with a picture is marked is_bad; take the mark off those that may be used")
    splits, said = _splits(root, data, frames, good)
    if splits is None and held_out:
        splits = {i: TRAIN if i < len(frames) - len(held_out) else TEST for i in good}
    paths = {i: path for i, path in good.items() if splits is None or i in splits}
    if bad := [path for i, path in found.paths.items() if i not in good]:
        said += (left_out(bad, len(found.paths), f"frames of {_FILE} are marked is_bad and are left out"),)
    if not paths:
        raise CaptureError(f"{_FILE}: no frame with a picture is in train_filenames, val_filenames or test_filenames; correct the lists")
    headers, alpha = checks.image_headers(root, paths.values())
    sizes = dict(zip(paths, headers, strict=True))
    times = transforms.times_of(frames, _FILE)
    stamps = timestamps(frames, _FILE, times is not None)
    times = stamps.since if times is None else times
    said += (stamps.note,) if stamps.note else ()
    # Files of this kind are often unsorted, so frames are sorted by time, or by the natural order of their names.
    keys: dict[int, Any] = {i: checks.natural_key(p) if times is None else (times[i], checks.natural_key(p)) for i, p in paths.items()}
    order = sorted(paths, key=lambda i: keys[i])
    shots, said_of_lenses = [], list[str]()
    for rank, i in enumerate(order):
        shot = shot_of(root, frames[i], data, places[i], paths[i], sizes[i], said_of_lenses, camera=0, time=float(rank))
        shot.time = shot.time if times is None else times[i]
        shot.seconds = None if stamps.since is None or stamps.unit is None else stamps.since[i] * stamps.unit
        shot.split = TRAIN if splits is None else splits[i]
        shots.append(shot)
    placed = Placed(False)
    if times is None:
        flat = any(posixpath.basename(posixpath.dirname(path)).lower() in SPLIT_WORDS for path in paths.values())
        placed = place_untimed(root, shots, options.static, flat=flat)
    fixed = fixed_cameras(shots)
    if not fixed and times is not None:
        moving_cameras(shots)
    several = len({shot.camera for shot in shots})
    if times is not None and not fixed and several == len(shots) > 1:
        said += (
            "frames share times, no camera stands still and folders do not tell them apart, so each frame counts as a camera of its own "
            "and no optical flow is measured",
        )
    of_frames = keep_masks.told(root, shots, "(mask_path)")
    masked = (of_frames,) if of_frames else keep_masks.add_masks(root, shots)
    said += lost_depth([frames[i] for i in order], shots)
    reading = Reading(
        why=f"{_FILE}, {'several cameras' if several > 1 else 'one moving camera'}",
        shots=shots,
        alpha=alpha,
        has_split=splits is not None,
        untimed=times is None and not placed.several,
        fps=_fps(data),
        fixed_cameras=fixed,
        sources=(_FILE, *placed.others),
        notes=(*found.notes, *said, *said_of_lenses, *placed.notes, *masked),
    )
    add_cloud(reading, root, data, _FILE)
    return reading


def _test_frames(data: dict[str, Any]) -> list[dict[str, Any]]:
    """The entries of `test_frames`, a second list beside `frames` in files of ScanNet++ (github.com/scannetpp/scannetpp)."""
    return transforms.frames_of({"frames": data["test_frames"]}, f"{_FILE}: test_frames") if data.get("test_frames") else []


def _fps(data: dict[str, Any]) -> float | None:
    return None if data.get("fps") is None else checks.number(data["fps"], f"{_FILE}: fps", 1e-3, 1e6)


def _splits(
    root: Path, data: dict[str, Any], frames: list[dict[str, Any]], paths: dict[int, str]
) -> tuple[dict[int, int] | None, tuple[str, ...]]:
    """Split of each frame, by its index, from nerfstudio's `train_filenames`, `val_filenames`, `test_filenames`, and notes; None without
    any of them.

    Without `train_filenames`, frames in no list train. With it they are left out, as in nerfstudio, and counted."""
    lists = {name: data.get(f"{name}_filenames") for name in SPLITS}
    if not any(lists.values()):
        return None, ()
    numbers: dict[str, list[int]] = {}
    for i, path in paths.items():
        for name in {_normal(root, str(frames[i].get("file_path"))), _normal(root, path)}:
            numbers.setdefault(name, []).append(i)
    listed = {_normal(root, str(frame.get("file_path"))) for frame in frames}
    result: dict[int, int] = {}
    both: dict[int, None] = {}
    unknown: list[str] = []
    for split, (name, entries) in enumerate(lists.items()):
        field = f"{name}_filenames"
        for n, raw in enumerate(checks.items(entries, f"{_FILE}: {field}") if entries else ()):
            path = _normal(root, checks.text(raw, f"{_FILE}: {field}[{n}]"))
            own = numbers.get(path) or next((numbers[path + s] for s in checks.IMAGE_SUFFIXES if path + s in numbers), [])
            for i in own:
                # nerfstudio writes the same list for val and test if there is only one held-out set. It counts as test.
                if result.get(i) == TRAIN != split:
                    both[i] = None
                result[i] = max(split, result.get(i, 0))
            if not own and path not in listed:  # one whose picture is missing has been counted already
                unknown.append(f"{field}[{n}]: {path[:200]!r}")
    notes = []
    if unknown:
        notes.append(f"{counted(len(unknown), 'entry', 'entries')} of the lists of {_FILE} without a frame: ignored; first {unknown[0]}")
    if both:
        first = next(iter(both))
        notes.append(
            f"{len(both)} of {len(paths)} frames of {_FILE} are in train_filenames and in a list that is held out; they are held out "
            f"and do not train (first {paths[first]}): remove them from one list"
        )
    rest = [i for i in paths if i not in result]
    given = " and ".join(f"{name}_filenames" for name, entries in lists.items() if entries)
    if rest and not lists["train"]:
        result |= dict.fromkeys(rest, TRAIN)
        notes.append(f"{_FILE} has {given} but no train_filenames: the {len(rest)} frames that are in no list train")
    elif rest:
        notes.append(f"{len(rest)} of {len(paths)} frames of {_FILE} are in none of {given} and are left out; first {paths[rest[0]]}")
    return result, tuple(notes)


def _normal(root: Path, path: str) -> str:
    """A path in one form of several: composed, relative if it leads into the capture."""
    path = path.replace("\\", "/")
    try:
        path = checks.relative(root, path, _FILE)
    except CaptureError:  # a path of another machine
        path = posixpath.normpath(path)
    return composed(path)
