"""`Capture`: the frames of a recording, known from names, JSON and image headers alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ...pipeline import CaptureError
from ..facts import Facts
from . import checks
from . import skipped_times as skipping
from .common_size import Crop, common_size, crop, told
from .far_away import brought_near, told_moved
from .reading import DEFAULT_FPS, SPLITS, TEST, TRAIN, VAL, Options, Reading, Shot, Video
from .usual import told_size


@dataclass(frozen=True)
class Capture:
    """A recognised capture. F frames in a fixed order that every stage uses.

    `files` are the paths, relative to `root`, whose content determines the result (the digest of the capture); `facts` is the
    mapping of docs/artifacts.md. Arrays are those of the `frames` artifact, at its output size (after `max_size`); K applies to the
    distorted pictures (`captures/lens.py` explains distortion and fisheye). crop [F,4]: left, top, width and
    height, px, of the part of each stored picture that is scaled to the output size; None if all are used whole. origin [3]: the
    point of the files' world that is the origin here, None if nothing was moved. keep_turns: the EXIF orientation by which each mask of
    `keeps` is rotated; 1 if it already has the orientation of its picture as shown.
    """

    root: Path
    name: str
    files: tuple[str, ...]
    facts: Mapping[str, Any]
    options: Options
    names: tuple[str, ...]
    images: tuple[str, ...] | None
    masks: tuple[str | None, ...] | None
    keeps: tuple[str | None, ...] | None
    keep_turns: tuple[int, ...] | None
    depths: tuple[str | None, ...] | None
    depth_confidences: tuple[str | None, ...] | None
    videos: tuple[Video, ...]
    camera: np.ndarray
    time: np.ndarray
    seconds: np.ndarray
    split: np.ndarray
    next: np.ndarray
    K: np.ndarray | None
    cam_from_world: np.ndarray | None
    distortion: np.ndarray | None
    fisheye: np.ndarray | None
    crop: np.ndarray | None
    background: str | None
    points: np.ndarray | None = None
    point_colors: np.ndarray | None = None
    origin: np.ndarray | None = None
    K_hint: tuple[float, ...] | None = None
    notes: tuple[str, ...] = ()
    chosen: Mapping[str, int] = field(default_factory=dict)  # settings of `frames` that were not given, and that `options.usual` decided


def assemble(root: Path, name: str, kind: str, reading: Reading, options: Options) -> Capture:
    """Converts a reader's frames to a `Capture`: times in [0,1], splits, pairs, facts. Raises CaptureError if they cannot be trained on."""
    shots = reading.shots
    _refuse_duplicates(shots)
    split = np.array([s.split for s in shots], dtype=np.uint8)
    if not reading.has_split and options.holdout and options.every_time == 1:
        split[np.arange(len(shots)) % options.holdout == 0] = TEST
    if not (split == TRAIN).any():
        raise CaptureError(
            f"{root}: {len(shots)} frames, none of them for training; "
            + ("check the split files" if reading.has_split else "use frames.holdout=0")
        )

    raw = np.array([s.time for s in shots], dtype=np.float64)
    time = np.zeros_like(raw) if options.static else _unit_times(raw)
    distinct = np.unique(np.round(time, 9))
    static = options.static or len(distinct) == 1
    fps = options.fps or reading.fps or DEFAULT_FPS
    seconds = np.array([t * (len(distinct) - 1) / fps if s.seconds is None else s.seconds for s, t in zip(shots, time, strict=True)])
    keys = sorted({s.camera for s in shots})
    index = {key: i for i, key in enumerate(keys)}
    camera = np.array([index[s.camera] for s in shots], dtype=np.int32)
    notes = reading.notes
    if options.every_time > 1:
        left_out = skipping.skipped_times(root, split == TRAIN, camera, time, options.every_time)
        split[split != TRAIN] = VAL  # new views apart from new times: one mean of both would say little about either
        split[left_out] = TEST
        notes += (skipping.told(split, time, options.every_time),)
    following = np.full(len(shots), -1, np.int32) if static else _next_frames(shots, camera, time, split)

    poses, points, origin = brought_near([s.cam_from_world for s in shots], reading.points)
    if origin is not None:
        notes += (told_moved(origin),)
    sizes = [s.size for s in shots]
    common = common_size(sizes)
    crops = [crop(size, common) for size in sizes]
    width, height = _output_size(*common, options.size_limit)
    chosen = {}
    if options.max_size is None and options.usual is not None and (width, height) != common:
        chosen["max_size"] = options.usual.size
        notes += (told_size(options.usual, common, (width, height)),)
    scale = _scaled((0, 0, *common), width, height)
    hint = None if reading.K_hint is None else tuple(float(v) for v in (scale @ reading.K_hint).reshape(-1))
    background = options.background or ("white" if reading.alpha else None)
    facts = Facts(
        format=kind,
        why=reading.why,
        frames=len(shots),
        cameras=len(keys),
        times=len(distinct),
        width=width,
        height=height,
        poses=poses is not None,
        points=points is not None,
        alpha=reading.alpha,
        static=static,
        pairs=int((following >= 0).sum()),
        fixed_cameras=reading.fixed_cameras,
        splits={name: int((split == i).sum()) for i, name in enumerate(SPLITS)},
        images_in_files=not reading.videos,
        upright=reading.upright,
        untimed=reading.untimed and not static,
        every_time=options.every_time,
    )
    images = None if reading.videos else tuple(str(s.file) for s in shots)
    masks = tuple(s.mask for s in shots) if any(s.mask for s in shots) else None
    keeps = tuple(s.keep for s in shots) if any(s.keep for s in shots) else None
    depths = tuple(s.depth for s in shots) if any(s.depth for s in shots) else None
    sure = tuple(s.depth_confidence for s in shots) if any(s.depth_confidence for s in shots) else None
    for shot in shots:
        for mask in filter(None, (shot.mask, shot.keep)):
            size = checks.image_header(root, mask)[:2]
            if (size[::-1] if shot.keep_turn in checks.LYING else size) != shot.size:
                raise CaptureError(f"{mask}: the mask is {size[0]}x{size[1]}, its image {shot.size[0]}x{shot.size[1]}; make them one size")
    checks.refuse_odd_names(s.name for s in shots)
    files = {
        *reading.sources,
        *(images or ()),
        *(m for m in (*(masks or ()), *(keeps or ()), *(depths or ()), *(sure or ())) if m),
        *(v.file for v in reading.videos),
    }
    checks.refuse_odd_names(sorted(files))
    checks.refuse_huge_files(root, sorted(files - {v.file for v in reading.videos}))
    return Capture(
        root=root,
        name=name,
        files=tuple(sorted(files)),
        facts=facts.as_json(),
        options=options,
        names=tuple(s.name for s in shots),
        images=images,
        masks=masks,
        keeps=keeps,
        keep_turns=None if keeps is None else tuple(s.keep_turn for s in shots),
        depths=depths,
        depth_confidences=sure,
        videos=reading.videos,
        camera=camera,
        time=time,
        seconds=seconds,
        split=split,
        next=following,
        K=None
        if poses is None
        else np.stack([_scaled(p, width, height) @ s.K for s, p in zip(shots, crops, strict=True) if s.K is not None]),
        cam_from_world=poses,
        distortion=None if poses is None else _distortions(shots),
        fisheye=np.array([s.fisheye for s in shots], np.uint8) if any(s.fisheye for s in shots) else None,
        crop=np.array(crops, np.int32) if len(set(sizes)) > 1 else None,
        background=background,
        points=points,
        point_colors=reading.point_colors,
        origin=origin,
        K_hint=hint,
        chosen=chosen,
        notes=(*notes, *([note] if (note := told(sizes, [s.name for s in shots], common)) else [])),
    )


def _distortions(shots: Sequence[Shot]) -> np.ndarray:
    """[F,4], or [F,8] if any lens has that many terms."""
    terms = [np.zeros(4) if s.distortion is None else s.distortion for s in shots]
    result = np.zeros((len(shots), max(map(len, terms))))
    for row, own in zip(result, terms, strict=True):
        row[: len(own)] = own
    return result


def _unit_times(raw: np.ndarray) -> np.ndarray:
    """Times of all splits together, rescaled to exactly [0,1]; 0 if all are equal. Motion, exports and the player cover that interval."""
    span = raw.max() - raw.min()
    return (raw - raw.min()) / span if span > 0 else np.zeros_like(raw)


def _output_size(width: int, height: int, max_size: int | None) -> tuple[int, int]:
    if not max_size or max(width, height) <= max_size:
        return width, height
    factor = max_size / max(width, height)
    return max(1, round(width * factor)), max(1, round(height * factor))


def _scaled(part: Crop, width: int, height: int) -> np.ndarray:
    """[3,3], maps pixels of a picture to those of its `part` scaled to width x height. Pixel centres lie at +0.5, so scaling needs no
    offset."""
    left, top, across, down = part
    return np.diag([width / across, height / down, 1.0]) @ np.array([[1.0, 0, -left], [0, 1.0, -top], [0, 0, 1.0]])


def _next_frames(shots: Sequence[Shot], camera: np.ndarray, time: np.ndarray, split: np.ndarray) -> np.ndarray:
    """Index of the same camera's train frame at its next time, -1 if none.

    Held-out frames have no next frame and are skipped, so that flow is never measured on a picture that is used for evaluation. Pictures
    of different sizes form no pair: scaled to a common size, they would seem to move. Nor do pictures with a cut between them.
    """
    result = np.full(len(shots), -1, np.int32)
    for key in np.unique(camera):
        members = np.flatnonzero(camera == key)
        members = members[np.argsort(time[members], kind="stable")].tolist()
        last, linked = -1, True
        for i in members:
            if split[i] == TRAIN:
                if last >= 0 and linked and time[i] > time[last] and shots[last].size == shots[i].size:
                    result[last] = i
                last, linked = i, True
            linked = linked and shots[i].linked
    return result


def _refuse_duplicates(shots: Sequence[Shot]) -> None:
    """Refuses a picture that appears twice in one split, or in training and in a held-out split: scores would be meaningless."""
    seen: dict[str, Shot] = {}
    for shot in shots:
        if shot.file is None:
            continue
        other = seen.setdefault(shot.file, shot)
        if other is not shot and (other.split == shot.split or TRAIN in (other.split, shot.split)):
            raise CaptureError(
                f"{shot.file}: listed twice (split {SPLITS[other.split]} and split {SPLITS[shot.split]}); list each image once"
            )
