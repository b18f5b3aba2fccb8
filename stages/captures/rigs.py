"""Several cameras of one capture: whether folders of images are the cameras of a rig, and whether cameras stand still."""

from __future__ import annotations

import posixpath
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from . import checks
from .listing.kinds import role_of
from .listing.numbers import follow_numbers, places, set_times, two_numbers, words
from .posed.time_folders import folders_are_times, frame_of, named_as_cameras, named_as_times
from .reading import Shot

ONE_CAMERA = "if one camera took all pictures, copy them into one folder, under names that differ (and add --static if nothing moves)"


@dataclass(frozen=True)
class Rig:
    """What the folders of images are.

    places: (camera, place of its time) of each image; None if the folders are no rig. gaps: whether times passed of which there are no
    pictures, by the numbers in the names. note: why they are no rig, or which numbers are skipped, for people. others: further pictures
    in the folders, relative to the capture, whose names this follows from as well.
    """

    places: list[tuple[str, int]] | None = None
    gaps: bool = False
    note: str | None = None
    others: tuple[str, ...] = ()


@dataclass(frozen=True)
class Placed:
    """What `place_untimed` has found. several: whether there are several cameras. notes: for people. others: see `Rig`."""

    several: bool
    notes: tuple[str, ...] = ()
    others: tuple[str, ...] = ()


def place_untimed(root: Path, shots: Sequence[Shot], static: bool, deleted: Sequence[str] = (), flat: bool = False) -> Placed:
    """Sets camera and time of each of ``shots``, whose files say neither: folders with files of the same names are the cameras of a rig, or
    its times; cameras that stand still are told by names and poses; else one camera moved, and its pictures follow the numbers in names.

    shots: in the order of their names. static: times do not matter. deleted: see `cameras_of`. flat: folders are no cameras."""
    files = [shot.file or shot.name for shot in shots]
    rig = Rig() if flat else cameras_of(root, files, deleted)
    if rig != Rig():  # several folders
        swapped, told = folders_are_times(shots)
        if swapped and (told is None or rig.places is not None):  # poses say it also of folders from which pictures are missing
            for shot, file in zip(shots, files, strict=True):
                shot.camera = checks.natural_key(frame_of(file))
            clock, skipped = _clock([posixpath.dirname(file) for file in files])
            set_times(shots, clock, max(clock) >= len(set(clock)))
            return Placed(True, tuple(line for line in (told, skipped) if line), rig.others)
        rig = replace(rig, note=rig.note or told)
    notes = (rig.note,) if rig.note else ()
    if rig.places is not None:
        for shot, (camera, _) in zip(shots, rig.places, strict=True):
            shot.camera = checks.natural_key(camera)
        set_times(shots, [time for _, time in rig.places], rig.gaps)
        return Placed(True, notes, rig.others)
    if static:
        return Placed(False, notes)
    named = cameras_in_names(shots)
    return Placed(named is not None, (*notes, *(follow_numbers(shots) if named is None else named)))


def _clock(folders: Sequence[str]) -> tuple[list[int], str | None]:
    """The place in time of each picture whose folder is a time, and a line if numbers of folders are missing."""
    distinct = folders_of([f"{folder}/" for folder in folders])
    clock, skipped = places([f"{folder}.png" for folder in distinct])
    place = dict(zip(distinct, clock, strict=True))
    return [place[folder] for folder in folders], skipped


def cameras_of(root: Path, images: Sequence[str], deleted: Sequence[str] = ()) -> Rig:
    """Whether `images`, paths relative to `root`, lie in several folders that contain files of the same names: `cam0/0001.jpg` and
    `cam1/0001.jpg` show the same time.

    One picture each in folders that are named as cameras show one time, whatever their names.

    The folders are compared as well as `images`, from which structure from motion may have dropped some frames of some cameras. One of
    the two must agree, so a picture too many in one folder does no harm if it has no pose. deleted: pictures that have a pose and are no
    longer there; they count as if they were, so that the rig remains one."""
    folders = folders_of(images)
    if len(folders) < 2:
        return Rig()
    listed = {folder: pictures_in(root, folder) for folder in folders}
    frames = {folder: {frame_of(name) for name in names} for folder, names in listed.items()}
    posed: dict[str, set[str]] = {folder: set() for folder in folders}
    for name in (*images, *(name for name in deleted if posixpath.dirname(name) in frames)):
        posed[posixpath.dirname(name)].add(frame_of(name))
        frames[posixpath.dirname(name)].add(frame_of(name))
    others = tuple(sorted({name for names in listed.values() for name in names} - set(images)))
    suffix = posixpath.splitext(images[0])[1]
    shared = checks.in_order(frame + suffix for frame in set.intersection(*frames.values()))
    clock, skipped = places(shared)
    number = dict(zip(map(frame_of, shared), clock, strict=True))
    same = any(all(names[folder] == names[folders[0]] for folder in folders) for names in (frames, posed))
    if same and all(frame_of(name) in number for name in images):
        return Rig([(posixpath.dirname(name), number[frame_of(name)]) for name in images], clock[-1] >= len(clock), skipped, others)
    if named_as_cameras(folders) and all(len(names) == 1 for names in posed.values()):
        return Rig([(posixpath.dirname(name), 0) for name in images], others=others)
    first = frames[folders[0]]
    other = next((folder for folder in folders if frames[folder] != first), None)
    counts = "" if other is None else f" ({len(first)} in {folders[0]}, {len(frames[other])} in {other})"
    note = (
        f"{len(folders)} folders of images do not hold files of the same names{counts}, so they are read as one camera over time, in the "
        "order of their names; for a rig of cameras name the frames of one time alike"
    )
    return Rig(note=note, others=others)


def cameras_in_names(shots: Sequence[Shot]) -> tuple[str, ...] | None:
    """If the names of pictures in one folder tell cameras and times apart: sets both, and returns lines for people. None otherwise.

    They do if they hold two numbers (`cam0_0001.png`), of which one is the camera, because all pictures with the same one have one pose; or
    a number and other words for each camera (`left_0001.png`)."""
    files = [shot.file or shot.name for shot in shots]
    one_folder = len(folders_of(files)) == 1
    columns = two_numbers(files) if one_folder else None
    for camera, time in (columns, columns[::-1]) if columns is not None else ():
        for shot, number in zip(shots, camera, strict=True):
            shot.camera = number
        if max(Counter(camera).values()) > 1 and all_fixed(shots):
            return _follow(shots, time)
    for shot in shots:
        shot.camera = 0
    named = words(files) if one_folder else None
    if named is None:
        return None
    for shot, text in zip(shots, named[0], strict=True):
        shot.camera = text
    first, other = (files[named[0].index(text)] for text in sorted(set(named[0]))[:2])
    told = f"names with other words and equal numbers, such as {first} and {other}, are read as {len(set(named[0]))} cameras at one time"
    return (told, *_follow(shots, named[1]))


def _follow(shots: Sequence[Shot], time: Sequence[int]) -> tuple[str, ...]:
    """Sets the times of ``shots`` of several cameras by the number in the name of each. Returns a line if numbers are missing."""
    numbers = sorted(set(time))
    clock, told = places([f"{number}.png" for number in numbers])
    place = dict(zip(numbers, clock, strict=True))
    set_times(shots, [place[number] for number in time], clock[-1] >= len(clock))
    return (told,) if told else ()


def all_fixed(shots: Sequence[Shot]) -> bool:
    """Whether these are several cameras with poses, each with only one pose."""
    first: dict[object, np.ndarray] = {}
    for shot in shots:
        pose = shot.cam_from_world
        if pose is not None and np.abs(first.setdefault(shot.camera, pose) - pose).max() > 1e-6:
            return False
    return len(first) > 1


def folders_of(images: Sequence[str]) -> list[str]:
    return sorted({posixpath.dirname(name) for name in images}, key=checks.natural_key)


def pictures_in(root: Path, folder: str) -> list[str]:
    """Files in a folder that are named like pictures, relative to `root`."""
    names = [f"{folder}/{name}" for name in checks.list_folder(root / folder) if name.lower().endswith(checks.IMAGE_SUFFIXES)]
    return [name for name in names if (root / name).is_file()]


def rig_without_poses(root: Path, folders: Sequence[str]) -> str | None:
    """What is missing where several folders have files of the same names, as those of a rig do, and no file gives poses; None elsewhere."""
    named: dict[str, frozenset[str]] = {}
    for folder in (folder for folder in folders if role_of(posixpath.basename(folder)) is None):  # depth, masks: of the same cameras
        pictures = frozenset(frame_of(name) for name in pictures_in(root, folder))
        if pictures:
            named[folder] = pictures
    if any(name.endswith(".pose.txt") for folder in named for name in checks.list_folder(root / folder)):
        return None  # sequences of one camera, each with its poses
    alike = [folder for folder in named if sum(names == named[folder] for names in named.values()) > 1]
    if len(alike) < 2 or 2 * len(alike) < len(named) or "images" in map(posixpath.basename, alike):
        return None
    seen = [
        name for name in checks.list_folder(root) if re.match(r"(poses_bounds|sparse|colmap|calib|cameras|models|intri|extri|annots)", name)
    ]
    also = f" (seen: {', '.join(seen[:6])})" if seen else ""
    shown, count = ", ".join(alike[:4]) + (", ..." if len(alike) > 4 else ""), len(named[alike[0]])
    what = "as the cameras of a rig do"
    if named_as_times(alike, sorted(named[alike[0]])):
        what = "and their names are numbers, so each seems to be one time, with a picture of each camera"
        also += ". Put the pictures of each camera into one folder"
    return (
        f"The folders {shown} have {count} pictures of the same names each, {what}, but no file that is read gives "
        f"their poses{also}. Add poses_bounds.npy with a row for each camera and name the folders cam00/, cam01/, ...; or put them into "
        "images/ beside a COLMAP model in sparse/0/; or encode each folder as a video and "
        f"give the folder of videos, whose poses are then estimated. Or, {ONE_CAMERA}"
    )
