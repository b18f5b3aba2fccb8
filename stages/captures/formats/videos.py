"""Several videos of one event without poses: each is a camera, in the order of the names, and all get frames at the same times.

Their clocks are aligned by the sound if it is clear in every video, or else by timecodes if every video has one; otherwise each begins at
0. The times are those of the camera with the lowest frame rate within the span that all videos share. From the other videos the nearest
frames are taken.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ....pipeline import CaptureError
from .. import checks
from ..clips import versions
from ..clips.passes import passes
from ..listing.copies import edited, same_bytes, told, told_edited
from ..reading import TEST, TRAIN, Options, Reading, Shot, Video
from ..sound import onsets
from ..sound.cache import onsets_of
from ..video import timecode
from ..video.survey import Survey
from ..video.together import told_together
from . import takes, video

_POSES = "poses_bounds.npy"  # if this file exists, the capture belongs to n3v, whatever the names of the videos
_FIRST_FRAMES = "aligned by their first frames"


def detect(root: Path) -> str | None:
    names = _videos(root)
    return None if names is None else f"{len(names)} videos without poses"


def read(root: Path, options: Options) -> Reading:
    names = _videos(root, forced=True)
    if names is None:
        raise CaptureError(f"{root}: fewer than two videos here; pass the folder that holds the videos of one event")
    for name in names:
        checks.resolve_inside(root, name, name)
    copied = same_bytes(root, names)
    names = [name for name in names if name not in copied]
    edits = edited(names)
    names = [name for name in names if name not in edits]
    roles, told_roles = passes(root, names)
    names = [name for name in names if name not in roles]
    if len(names) < 2 and not edits and not roles:
        raise CaptureError(f"{root}: its videos are copies of one, byte for byte; pass that one: {root / names[0]}")
    meant = options.format == "videos" or options.sync is not None  # the user has said that they are cameras
    if not meant:
        takes.refuse_chapters(root, names)
    probed = {name: video.survey(root, name) for name in names}
    left_out = versions.older(root, probed)
    headers = {name: header for name, header in probed.items() if name not in left_out}
    names = list(headers)
    twice = (*told(copied, "videos"), *told_edited(edits, "videos"), *told_roles, *versions.told(left_out, probed))
    if len(names) < 2:  # one camera over time
        if options.sync is not None:
            raise CaptureError(f"{root}: frames.sync aligns several cameras; leave it unset: {'; '.join(twice)}")
        alone = video.read(root / names[0], options)
        spoken_for = (*alone.spoken_for, *edits, *roles)
        return replace(alone, sources=(*alone.sources, *copied, *left_out), notes=(*twice, *alone.notes), spoken_for=spoken_for)
    shifts, how, doubt = clocks(root, headers, options.sync, options.audio_cache)
    if how.startswith(_FIRST_FRAMES) and not meant:
        takes.refuse_parts(root, headers)
    after = () if meant else takes.follow_each_other(headers)
    if not after and options.sync is None and how.startswith(_FIRST_FRAMES):
        after = takes.begun_apart(headers)
    local = [np.asarray(headers[name].seconds) for name in names]
    times, taken = _shared(names, local, shifts, options)
    late = max(float(np.abs(s[list(t)] + shift - times).max()) for s, t, shift in zip(local, taken, shifts, strict=True))
    shots = [
        Shot(
            name=f"{name}#{i}",
            camera=number,
            time=float((times[k] - times[0]) / (times[-1] - times[0])),
            size=(headers[names[number]].width, headers[names[number]].height),
            seconds=float(times[k] - times[0]),
            split=TEST if options.holdout and options.every_time == 1 and not options.static and k % options.holdout == 0 else TRAIN,
        )
        for number, name in enumerate(names)
        for k, i in enumerate(taken[number])
    ]
    return Reading(
        why=f"{len(names)} videos without poses, {how}; each is one camera",
        shots=shots,
        has_split=not options.static,  # times are held out for all cameras together, so each time has all of them or none
        fps=headers[names[0]].fps,
        videos=tuple(Video(name, n * len(times), taken[n], len(headers[name].seconds)) for n, name in enumerate(names)),
        sources=(*copied, *left_out),
        spoken_for=(*edits, *roles),
        notes=(*twice, _told(names, shifts, times, taken, headers, how, late), *doubt, *after, *told_together(headers)),
    )


def clocks(
    root: Path, headers: Mapping[str, Survey], sync: str | None, heard_before: Path | None = None
) -> tuple[list[float], str, tuple[str, ...]]:
    """Seconds to add to each video's own times to bring them to one clock, how they were found, and a line if timecodes say otherwise.

    sync: what to align by; CaptureError if that is not possible. None takes the sound, else timecodes, else the first frames.
    heard_before: folder that caches the envelopes of long sounds (`sound/cache.py`).
    """
    names, videos = list(headers), list(headers.values())
    zero = [0.0] * len(names)
    if sync == "frames":
        return zero, _FIRST_FRAMES, ()
    # sound and timecodes run from the start of the track, of which the first pictures may be lost
    late = [header.late - videos[0].late for header in videos]
    coded = timecode.shifts([h.timecode for h in videos], [h.fps for h in videos], [h.seconds[-1] + h.late for h in videos])
    heard = None
    if sync != "timecode":
        heard = _by_sound(root, names, heard_before)
        if isinstance(heard, str) and sync == "sound":
            raise CaptureError(f"{root}: {heard}; start all videos with a clap, or trim them to one start and use frames.sync=frames")
    if isinstance(heard, list):
        shifts = [a + b for a, b in zip(heard, late, strict=True)]
        off = 0.0 if coded is None else max(abs(a - b) for a, b in zip(heard, coded, strict=True))
        frame = max(1 / (header.fps or math.inf) for header in videos)
        doubt = (
            (f"by their timecodes they would be up to {off:.3f} s elsewhere; frames.sync=timecode goes by these",)
            if off > 1.5 * frame
            else ()
        )
        return shifts, "aligned by their sound", doubt
    if coded is not None:
        return [a + b for a, b in zip(coded, late, strict=True)], "aligned by their timecodes", ()
    if sync == "timecode":
        told = ", ".join(f"{name} {header.timecode or 'none'}" for name, header in headers.items())
        raise CaptureError(
            f"{root}: the timecodes of its videos do not align them ({told}): each needs one, all of the same kind, and they must overlap; "
            "leave frames.sync unset to align them by sound"
        )
    return zero, f"{_FIRST_FRAMES} ({heard})", ()


def _by_sound(root: Path, names: Sequence[str], heard_before: Path | None) -> list[float] | str:
    """The shifts by sound; text that says which video has none, or none that is clear."""
    heard = []
    for name, envelope in zip(names, onsets_of(root, names, heard_before), strict=True):
        if envelope is None:
            return f"{name} has no sound that can be read"
        heard.append(envelope)
    longest = max(range(len(names)), key=lambda n: len(heard[n][0]))
    shifts = []
    for name, envelope in zip(names, heard, strict=True):
        shift = 0.0 if envelope is heard[longest] else onsets.offset(heard[longest], envelope)
        if shift is None:
            return f"the sound of {name} fits that of {names[longest]} at no shift clearly better than at others"
        shifts.append(shift)
    return [shift - shifts[0] for shift in shifts]


def _shared(
    names: Sequence[str], local: Sequence[np.ndarray], shifts: Sequence[float], options: Options
) -> tuple[np.ndarray, list[tuple[int, ...]]]:
    """Times [T] on the shared clock, and for each video the indices [T] of the frames nearest to them, none used twice."""
    gaps = [float(np.median(np.diff(s))) if len(s) > 1 else 0.0 for s in local]
    for name, seconds in zip(names, local, strict=True):
        if len(seconds) < 2:
            raise CaptureError(f"{name}: only one frame; a camera needs more, so take the file out of the folder")
    slowest = max(range(len(names)), key=lambda n: gaps[n])
    begin = max(range(len(names)), key=lambda n: shifts[n])
    end = min(range(len(names)), key=lambda n: shifts[n] + local[n][-1])
    times = local[slowest] + shifts[slowest]
    times = times[(times >= shifts[begin] - 0.5 * gaps[begin]) & (times <= shifts[end] + local[end][-1] + 0.5 * gaps[end])]
    nearest = [_nearest(s + shift, times) for s, shift in zip(local, shifts, strict=True)]
    fresh = np.ones(len(times), bool)
    for indices in nearest:
        fresh[1:] &= np.diff(indices) > 0
    kept = np.flatnonzero(fresh)
    # A static scene needs a pose for every frame and matches between all of them, so all videos together get as many frames as one alone.
    limit = video.MOST_FRAMES // (len(names) if options.static else 1)
    kept = kept[list(video.choose(len(kept), options, max(2, limit)))] if len(kept) else kept
    if len(kept) < 2:
        raise CaptureError(
            f"{names[end]}: shares {len(kept)} time(s) with {names[begin]} on their common clock (it ends at "
            f"{local[end][-1] + shifts[end]:.2f} s, the other begins at {shifts[begin]:.2f} s, both since {names[0]} began); trim the "
            f"videos to one event, or take the odd one out{', or lower frames.every' if options.every else ''}"
        )
    return times[kept], [tuple(int(i) for i in indices[kept]) for indices in nearest]


def _nearest(seconds: np.ndarray, times: np.ndarray) -> np.ndarray:
    """[T] int: index of the value of `seconds` (sorted) nearest to each time; the earlier one of two equally near ones."""
    after = np.clip(np.searchsorted(seconds, times), 1, len(seconds) - 1)
    return np.where(times - seconds[after - 1] <= seconds[after] - times, after - 1, after)


def _told(
    names: Sequence[str],
    shifts: Sequence[float],
    times: np.ndarray,
    taken: Sequence[tuple[int, ...]],
    headers: dict[str, Survey],
    how: str,
    late: float,
) -> str:
    starts = ", ".join(f"{name} {shift:+.3f} s" for name, shift in zip(names, shifts, strict=True) if abs(shift) > 5e-4)
    step = taken[0][1] - taken[0][0]
    counts = sorted({len(headers[name].seconds) for name in names})
    return (
        f"{len(names)} videos {how}{f' ({starts})' if starts else ''}: took {len(times)} times that all of them share, of "
        f"{counts[0]}{f' to {counts[-1]}' if len(counts) > 1 else ''} frames"
        f"{f' (every {step} of {names[0]})' if step > 1 else ''}; frames are at most {1000 * late:.0f} ms off the shared times"
    )


def _videos(root: Path, forced: bool = False) -> list[str] | None:
    """The videos of a folder with at least two videos, no images and no poses (forced: whatever else it has); None otherwise."""
    if not root.is_dir():
        return None
    names = [name for name in checks.list_folder(root) if (root / name).is_file()]
    found = [name for name in names if name.lower().endswith(checks.VIDEO_SUFFIXES)]
    other = _POSES in names or any(name.lower().endswith(checks.IMAGE_SUFFIXES) for name in names)
    return found if len(found) > 1 and (forced or not other) else None
