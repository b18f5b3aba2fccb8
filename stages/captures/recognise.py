"""`recognise(path)`: determines the format of a capture from its files, and why."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any, Literal, get_args

from ...pipeline import CaptureError
from . import checks
from .assembly.assemble import assemble
from .assembly.transparent import judge_alpha
from .capture import Capture
from .formats import colmap, dnerf, images, llff, n3v, nerfies, nerfstudio, panoptic, video, videos
from .formats.scans import polycam, record3d, rgbd, stray, tum
from .keep_masks import FOLDER
from .listing import beside
from .listing.archive_kind import archive_kind
from .listing.depth_maps import add_depth
from .listing.kinds import kind_of, role_of
from .listing.names import is_video
from .listing.several import apart, several
from .listing.unread import above, described, models_in, only_closed, refuse_closed, unread, with_pictures
from .posed.doubts import doubts
from .reading import Options, Reading
from .rigs import ONE_CAMERA, pictures_in, rig_without_poses

Format = Literal[
    "dnerf",
    "n3v",
    "panoptic",
    "nerfstudio",
    "nerfies",
    "colmap",
    "llff",
    "record3d",
    "polycam",
    "stray",
    "rgbd",
    "tum",
    "images",
    "video",
    "videos",
]
FORMATS: tuple[Format, ...] = get_args(Format)
# Formats with poses are tried first. A plain folder of images or a lone video is the fallback if no other file says more.
_POSED: dict[Format, ModuleType] = {
    "dnerf": dnerf,
    "n3v": n3v,
    "panoptic": panoptic,
    "nerfstudio": nerfstudio,
    "nerfies": nerfies,
    "colmap": colmap,
    "llff": llff,
    "record3d": record3d,
    "polycam": polycam,
    "stray": stray,
    "rgbd": rgbd,
    "tum": tum,
}
_BARE: dict[Format, ModuleType] = {"images": images, "video": video, "videos": videos}
_ADDRESS = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+:)/+(.*)", re.DOTALL)  # a drive has one letter
_STEPPED = ("n3v", "stray", "images", "video", "videos")


def recognise(path: str | Path, format: str | None = None, **settings: Any) -> Capture:
    """Reads a capture's names, JSON and image headers. Decodes a video's first frame, or some where its name is unclear, and a few
    pictures with alpha or twice as wide as high.

    `format` forces a reader. settings: the others of `Options`. Raises `CaptureError` if the capture is unreadable or inconsistent, or fits
    two formats.
    """
    options = Options(format, **settings)
    root = _existing(Path(path))
    kind = _choose(root, format)
    if (options.max_frames or options.every) and kind not in _STEPPED:
        raise CaptureError(f"{root}: frames.every and frames.max_frames thin {', '.join(_STEPPED)}, not {kind}; leave them unset")
    if options.sync is not None and kind != "videos":
        raise CaptureError(f"{root}: frames.sync aligns several videos without poses, not {kind}; leave it unset")
    try:
        reading = (_POSED | _BARE)[kind].read(_the_video(root) if kind == "video" else root, options)
    except CaptureError as error:
        if format is None and root.is_file() and kind_of(root.name) is None:  # it may have been a video all the same
            raise CaptureError(f"{root}: no kind of file that is known; pass pictures or videos ({error})") from error
        raise
    if options.fps is not None and any(shot.seconds is not None for shot in reading.shots):
        raise CaptureError(
            f"{root}: frames.fps is for pictures without times, but the layout {kind} has its own; leave it unset, or give a video another "
            "rate with ffmpeg -r RATE -i FILE NEW"
        )
    base = root if root.is_dir() else root.parent
    judge_alpha(base, reading, kind, options.background)
    reading.notes += doubts(reading.shots, reading.sources)
    said, unfit = add_depth(base, reading.shots)
    reading.notes += said or reading.depth_notes
    reading.spoken_for += unfit
    capture = assemble(base, root, _name(root), kind, reading, options)
    return replace(capture, notes=(*capture.notes, *_not_read(root, capture, reading)))


def _not_read(root: Path, capture: Capture, reading: Reading) -> tuple[str, ...]:
    """A line for each known kind of file that the result does not depend on, except where the reader's notes have said it."""
    kind, options = capture.facts["format"], capture.options
    around = above(root, kind, capture.files)
    if root.is_file():
        return around
    masks = (FOLDER,) if any(f"in {FOLDER}/" in note or note.startswith(f"{FOLDER}/") for note in reading.notes) else ()
    thinned = bool(options.every or options.max_frames) or any("without a pose" in note for note in reading.notes)
    return (*around, *unread(root, kind, capture.files, (*reading.spoken_for, *masks), thinned))


def _the_video(root: Path) -> Path:
    """The one video of a folder that has pictures as well; otherwise `root`, about which the reader decides."""
    if root.is_dir():
        names = [name for name in checks.list_files(root) if is_video(name)]
        if len(names) == 1:
            return root / names[0]
    return root


def _name(root: Path) -> str:
    """Name of the scene: that of the folder or file. `room/images` is called `room-images`, since many captures have a folder `images`."""
    name = root.stem if root.is_file() else root.name
    return f"{root.parent.name}-{name}" if name == "images" and root.parent.name else name or "capture"


def _existing(path: Path) -> Path:
    try:
        root = path.expanduser().resolve(strict=True)
    except (OSError, RuntimeError, ValueError) as error:
        if (address := _ADDRESS.match(str(path))) is not None:  # a Path has one slash of the two
            raise CaptureError(f"{address[1]}//{address[2]}: an address, not a file; download it first, and pass the file") from error
        raise CaptureError(f"{path}: no such file or folder; check the path of the capture") from error
    checks.refuse_odd_names([str(root)])
    if not root.is_dir() and not root.is_file():
        raise CaptureError(f"{path}: neither a file nor a folder; pass a video or the capture's folder")
    if root.is_file() and (found := several(root)) is not None:
        raise CaptureError(apart(root, found))
    if root.is_file() and root.suffix.lower() in (".json", ".npy", *checks.IMAGE_SUFFIXES):
        raise CaptureError(f"{path}: this is one file of a capture; pass its folder {root.parent}")
    known = kind_of(root.name) if root.is_file() else None
    if known is not None and known.group == "picture":
        advice = f"of a kind that is not read; {known.advice}, and pass their folder"
        raise CaptureError(f"{path}: this is one picture of a capture ({known.one}), {advice}")
    if (archive := archive_kind(root)) is not None:
        raise CaptureError(f"{path}: this is an archive ({archive}); unpack it and pass its folder")
    if known is not None and known.group != "video":
        raise CaptureError(f"{path}: a file of this kind ({known.one}) is no capture; pass the pictures or videos that it was made of")
    return root


def _choose(root: Path, format: str | None) -> Format:
    if format is not None:
        chosen = next((known for known in FORMATS if known == format), None)
        if chosen is None:
            raise CaptureError(f"--format {format}: unknown; the formats are {', '.join(FORMATS)}")
        return chosen
    if root.is_file():
        refuse_closed(root)
        return "video"
    if not checks.list_folder(root):
        raise CaptureError(f"{root}: the folder is empty; pass a video, a folder of images, or a capture with poses")
    found = _candidates(root, _POSED)
    if not found:
        if (kind := beside.chosen(root, checks.list_files(root))) is not None:
            return kind
        found = _candidates(root, _BARE)
    if len(found) > 1:
        reasons = " and as ".join(f"{kind} ({why})" for kind, why in found.items())
        choices = " or ".join(f"--format {kind}" for kind in found)
        raise CaptureError(f"{root}: can be read as {reasons}; choose with {choices}")
    if not found:
        raise CaptureError(f"{root}: nothing recognised here. {_advice(root)}")
    return next(iter(found))


def _candidates(root: Path, readers: dict[Format, ModuleType]) -> dict[Format, str]:
    return {kind: why for kind, reader in readers.items() if (why := reader.detect(root)) is not None}


def _advice(root: Path) -> str:
    """The most likely reason why a folder was not recognised."""
    names = checks.list_folder(root)
    for part in ("", "sparse/0/", "sparse/"):
        for name in checks.list_folder(root / part) if (root / part).is_dir() else ():
            if not (root / part / name).is_file() and not (root / part / name).is_dir():
                return f"{part}{name} is not a file but a broken link, a pipe or a device; put the file itself there"
    folders = [name for name in names if (root / name).is_dir() and not checks.is_foreign(root / name)]
    there = described(root)
    inside = _inside(root, folders)
    if (rig := rig_without_poses(root, folders) or rig_without_poses(root, inside)) is not None:
        return f"{rig}{there}"
    if "poses_bounds.npy" in names:
        return "poses_bounds.npy needs cameras named cam00.mp4, cam01.mp4, ... or folders cam00/, cam01/, ..."
    if only_closed(root):
        return there.removeprefix(". ")
    if (models := models_in(root)) and not with_pictures(root):
        return _place_of_pictures(models[0])
    if folders:
        named = f"It has the folders {', '.join(folders[:6])}"
        if with_pictures(root):
            several = any(sum(role_of(n) is None and bool(pictures_in(root, n)) for n in names) > 1 for names in (folders, inside))
            one = f"; {ONE_CAMERA}" if several else ""
            return f"{named}: pass the one that holds images or videos, or add transforms.json{one}{there}"
        return f"{named}, with no picture or video in any: copy them there, or pass another folder{there}"
    known = "transforms.json, transforms_train.json, train_meta.json, or camNN.mp4 with poses_bounds.npy"
    odd = Counter(Path(name).suffix for name in names if kind_of(name) is None and Path(name).suffix).most_common(1)
    unknown = f". No kind of file that is known ends in {odd[0][0]} (here {odd[0][1]})" if odd else ""
    return f"Expected a video or several of one event, images, {known}{there}{unknown}"


def _inside(root: Path, folders: list[str]) -> list[str]:
    """The folders in images/, or in the only folder that the capture has, relative to `root`."""
    outer = "images" if "images" in folders else folders[0] if len(folders) == 1 else None
    if outer is None:
        return []
    return [f"{outer}/{name}" for name in checks.list_folder(root / outer) if (root / outer / name).is_dir()]


def _place_of_pictures(model: str) -> str:
    """Where the pictures of the COLMAP model in the folder `model` belong, which came without any."""
    top = model.split("/")[0]
    if not top or top.isdecimal():
        return "It is a COLMAP model without its pictures: pass the folder that holds sparse/ with the model, and beside it images/"
    return f"The COLMAP model in {model} is there, but none of its pictures: copy images/ beside {top}/"
