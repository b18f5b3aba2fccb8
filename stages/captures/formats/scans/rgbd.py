"""Colour pictures with a pose file each, as of scans with a depth camera: `frame-000000.color.png` and `frame-000000.pose.txt` (7-Scenes,
BundleFusion, 3DMatch), `color/0.jpg` and `pose/0.txt` (ScanNet), or `rgb/0_07.png` and `pose/0_07.txt` (NSVF; 0 train, 1 val, 2 test).

A pose is a 4x4 matrix, camera to world, OpenCV axes; a tracker that was lost writes Inf or NaN. 7-Scenes has no intrinsics: its page
(microsoft.com/en-us/research/project/rgb-d-dataset-7-scenes) gives 585 px and the principal point (320, 240) for its pictures of 640x480.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from .....pipeline import CaptureError
from ... import checks
from ...posed.depth import told_depth
from ...posed.finding import left_out
from ...posed.matrix_files import INTRINSICS, intrinsics_of, is_nsvf, pose_of
from ...posed.sizes import scale_of
from ...posed.stated import states_layout
from ...reading import TRAIN, Options, Reading, Shot

_COLOURS, _POSES = ("color", "colour", "rgb", "images"), ("pose", "poses")
_KINECT = np.array([[585.0, 0, 320], [0, 585, 240], [0, 0, 1]])


def detect(root: Path) -> str | None:
    pairs, place = ({}, "") if states_layout(root) else _pairs(root)
    return f"{len(pairs)} pictures with a pose file each in {place}" if any(all(pair) for pair in pairs.values()) else None


def read(root: Path, options: Options) -> Reading:
    pairs, place = _pairs(root)
    both = {stem: pair for stem, pair in pairs.items() if all(pair)}
    if not both:
        raise CaptureError(f"{root}: no picture with a pose file of its name, such as frame-000000.color.png and frame-000000.pose.txt")
    poses = {stem: pose_of(root, str(pose)) for stem, (_, pose) in both.items()}
    stems = [stem for stem in both if poses[stem] is not None]
    lost, unposed = [s for s in both if poses[s] is None], [str(p[0]) for p in pairs.values() if p[0] and not p[1]]
    deleted = [str(p[1]) for p in pairs.values() if p[1] and not p[0]]
    posed = len(both) + len(deleted)
    if not stems or 2 * (len(lost) + len(deleted)) > posed:
        raise CaptureError(f"{place}: {len(lost)} of {posed} poses are not finite and {len(deleted)} have no picture; add the files")
    files = [str(both[stem][0]) for stem in stems]
    for file in files:
        checks.resolve_inside(root, file, file)
    sizes, alpha = checks.image_headers(root, files)
    source, K, made_for = intrinsics_of(root) or (None, _KINECT, (640, 480))
    notes = []
    if source is None:
        if set(sizes) != {(640, 480)}:
            raise CaptureError(
                f"{root}: the files give poses but no intrinsics; add K.txt, nine numbers of the 3x3 camera matrix in px (also read: "
                f"{', '.join(INTRINSICS[1:])})"
            )
        notes.append(
            "no file gives the intrinsics; taken are those of 7-Scenes (585 px, principal point 320, 240); add K.txt to correct them"
        )
    numbers = [int(m[-1]) if (m := re.findall(r"\d+", s)) and len(m[-1]) < 10 else -1 for s in stems]
    counted = min(numbers) >= 0 and len(set(numbers)) == len(numbers)
    splits = {stem: int(stem[0]) for stem in stems if re.match("[012]_", stem)} if is_nsvf(root) else {}
    split = len(splits) == len(stems) and len({*splits.values(), 0}) == len({*splits.values()}) > 1
    if split:
        notes.append("names that begin with 0_, 1_ and 2_ are read as views for training, validation and test, as in NSVF, of one moment")
    shots = []
    for rank, (stem, file, size) in enumerate(zip(stems, files, sizes, strict=True)):
        shot = Shot(name=file, camera=0, time=0.0 if split else float(numbers[rank] if counted else rank), size=size, file=file)
        shot.split = splits[stem] if split else TRAIN
        shot.cam_from_world = checks.inverse(np.asarray(poses[stem]))
        shot.K = np.diag([*scale_of(root, file, size, made_for or sizes[0], f"{source or '7-Scenes'}: for"), 1.0]) @ K
        shots.append(shot)
    for names, total, words in (
        ([str(both[s][1]) for s in lost], posed, "poses are not finite, since the tracker was lost, and are left out"),
        (deleted, posed, "poses have no picture and are left out"),
        (unposed, len(pairs), "pictures have no pose file and are left out"),
    ):
        notes += [left_out(names, total, words)] if names else []
    depth = _depth(root)
    return Reading(
        why=f"{len(shots)} pictures with a pose file each in {place}, one moving camera",
        shots=shots,
        alpha=alpha,
        has_split=split,
        sources=(*((source,) if source else ()), *(str(both[stem][1]) for stem in both)),
        notes=tuple(notes),
        depth_notes=told_depth(root, depth),
        spoken_for=(*depth, *deleted, *unposed, *(str(name) for stem in lost for name in both[stem])),
    )


def _pairs(root: Path) -> tuple[dict[str, tuple[str | None, str | None]], str]:
    """(picture, pose file) by the name that they share, in natural order, and the place, for people."""
    if not root.is_dir():
        return {}, ""
    names = checks.list_folder(root)
    poses = {n[: -len(".pose.txt")]: n for n in names if n.endswith(".pose.txt")}
    if poses:
        found = {}
        for name in names:
            parts = re.fullmatch(r"(.+)\.(?:color|colour|rgb)\.(?:png|jpe?g)", name, re.IGNORECASE)
            if parts:
                found[parts[1]] = name
        return _joined(found, poses), "the folder"
    for colour, pose in ((c, p) for c in _COLOURS for p in _POSES if c in names and p in names):
        if not ((root / colour).is_dir() and (root / pose).is_dir()):
            continue
        pictures = {
            n.rsplit(".", 1)[0]: f"{colour}/{n}" for n in checks.list_folder(root / colour) if n.lower().endswith(checks.IMAGE_SUFFIXES)
        }
        files = {n[:-4]: f"{pose}/{n}" for n in checks.list_folder(root / pose) if n.endswith(".txt")}
        if set(pictures) & set(files):
            return _joined(pictures, files), f"{colour}/ and {pose}/"
    return {}, ""


def _joined(pictures: dict[str, str], poses: dict[str, str]) -> dict[str, tuple[str | None, str | None]]:
    return {stem: (pictures.get(stem), poses.get(stem)) for stem in sorted({*pictures, *poses}, key=checks.natural_key)}


def _depth(root: Path) -> tuple[str, ...]:
    names = checks.list_folder(root)
    return tuple(n for n in names if re.search(r"\.depth(\.proj)?\.(png|pgm|exr)$", n) or (n == "depth" and (root / n).is_dir()))
