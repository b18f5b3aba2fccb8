"""Makes a `Capture` of what a reader found."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ....pipeline import CaptureError
from ...facts import STANDS_STILL, Facts
from .. import checks
from ..capture import Capture
from ..reading import SPLITS, TRAIN, Options, Reading, Shot
from ..usual import told_size
from .common_size import Crop, common_size, crop, told
from .far_away import brought_near, told_moved
from .one_place import joined_place
from .quarter_turns import told as told_turned
from .quarter_turns import turned_alike
from .timeline import Timeline, timeline, told_rate


def assemble(root: Path, given: Path, name: str, kind: str, reading: Reading, options: Options) -> Capture:
    """Converts a reader's frames to a `Capture`: times in [0,1], splits, pairs, facts. root: the folder of the files. given: what the user
    gave, which messages name: it may be a file. Raises CaptureError if the frames cannot be trained on."""
    shots = reading.shots
    _refuse_duplicates(shots)
    stands = joined_place(shots)
    reading.fixed_cameras |= stands
    when = timeline(given, reading, options)
    _check_masks(root, shots)
    common = common_size([s.size for s in shots])
    shots, turns = turned_alike(root, shots, common, reading.upright)
    sizes = [s.size for s in shots]
    poses, points, origin = brought_near([s.cam_from_world for s in shots], reading.points)
    crops = [crop(size, common) for size in sizes]
    width, height = _output_size(*common, options.size_limit)
    notes = [
        *reading.notes,
        *when.notes,
        *told_rate(kind, reading, options, when),
        *([] if origin is None else [told_moved(origin)]),
        *([STANDS_STILL] if stands else []),
    ]
    chosen = {}
    if options.max_size is None and options.usual is not None and (width, height) != common:
        chosen["max_size"] = options.usual.size
        notes.append(told_size(options.usual, common, (width, height)))
    notes += told_turned(shots, turns)
    if note := told(sizes, [s.name for s in shots], common):
        notes.append(note)
    scale = _scaled((0, 0, *common), width, height)
    hint = None if reading.K_hint is None else tuple(float(v) for v in (scale @ reading.K_hint).reshape(-1))
    masks = tuple(s.mask for s in shots) if any(s.mask for s in shots) else None
    keeps = tuple(s.keep for s in shots) if any(s.keep for s in shots) else None
    depths = tuple(s.depth for s in shots) if any(s.depth for s in shots) else None
    sure = tuple(s.depth_confidence for s in shots) if any(s.depth_confidence for s in shots) else None
    checks.refuse_odd_names(s.name for s in shots)
    return Capture(
        root=root,
        name=name,
        files=_files(root, reading),
        facts=_facts(kind, reading, options, when, (width, height), poses is not None, points is not None).as_json(),
        options=options,
        names=tuple(s.name for s in shots),
        images=None if reading.videos else tuple(str(s.file) for s in shots),
        masks=masks,
        keeps=keeps,
        keep_turns=None if keeps is None else tuple(s.keep_turn for s in shots),
        depths=depths,
        depth_confidences=sure,
        videos=reading.videos,
        camera=when.camera,
        time=when.time,
        seconds=when.seconds,
        split=when.split,
        next=when.next,
        K=None
        if poses is None
        else np.stack([_scaled(p, width, height) @ s.K for s, p in zip(shots, crops, strict=True) if s.K is not None]),
        cam_from_world=poses,
        distortion=None if poses is None else _distortions(shots),
        fisheye=np.array([s.fisheye for s in shots], np.uint8) if any(s.fisheye for s in shots) else None,
        crop=np.array(crops, np.int32) if len(set(sizes)) > 1 else None,
        turns=turns,
        background=options.background or ("white" if reading.alpha else None),
        points=points,
        point_colors=reading.point_colors,
        origin=origin,
        K_hint=hint,
        chosen=chosen,
        notes=tuple(notes),
    )


def _facts(kind: str, reading: Reading, options: Options, when: Timeline, size: tuple[int, int], poses: bool, points: bool) -> Facts:
    return Facts(
        format=kind,
        why=reading.why,
        frames=len(reading.shots),
        cameras=when.cameras,
        times=when.times,
        width=size[0],
        height=size[1],
        poses=poses,
        points=points,
        alpha=reading.alpha,
        static=when.static,
        pairs=int((when.next >= 0).sum()),
        fixed_cameras=reading.fixed_cameras,
        splits={name: int((when.split == i).sum()) for i, name in enumerate(SPLITS)},
        images_in_files=not reading.videos,
        upright=reading.upright,
        untimed=reading.untimed and not when.static,
        depths=sum(shot.depth is not None for shot in reading.shots),
        every_time=options.every_time,
    )


def _files(root: Path, reading: Reading) -> tuple[str, ...]:
    """All files that the result depends on, sorted. Raises CaptureError for one that is too large or has an impossible name."""
    videos = {v.file for v in reading.videos}
    pictures = set() if reading.videos else {str(s.file) for s in reading.shots}
    beside = (f for s in reading.shots for f in (s.mask, s.keep, s.depth, s.depth_confidence))
    files = {*reading.sources, *pictures, *videos, *filter(None, beside)}
    checks.refuse_odd_names(sorted(files))
    checks.refuse_huge_files(root, sorted(files - videos))
    return tuple(sorted(files))


def _check_masks(root: Path, shots: Sequence[Shot]) -> None:
    """Raises CaptureError for a mask that has not the size of its picture."""
    for shot in shots:
        for mask in filter(None, (shot.mask, shot.keep)):
            size = checks.image_header(root, mask)[:2]
            if (size[::-1] if shot.keep_turn in checks.LYING else size) != shot.size:
                raise CaptureError(f"{mask}: the mask is {size[0]}x{size[1]}, its image {shot.size[0]}x{shot.size[1]}; make them one size")


def _distortions(shots: Sequence[Shot]) -> np.ndarray:
    """[F,4], or [F,8] if any lens has that many terms."""
    terms = [np.zeros(4) if s.distortion is None else s.distortion for s in shots]
    result = np.zeros((len(shots), max(map(len, terms))))
    for row, own in zip(result, terms, strict=True):
        row[: len(own)] = own
    return result


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
