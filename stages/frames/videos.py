"""Pictures of the capture's videos: decoded, or copied from an earlier result that decoded the same files."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from ...pipeline import ArtifactError, Context, Given
from ...vision.images.film import Film, small
from ..captures import Capture, Video
from ..captures.formats.video import decode
from ..facts import Facts
from .artifact import create_images, pictures_of_video, write_videos
from .odd_frames import told

if TYPE_CHECKING:
    import zarr


def video_parts(capture: Capture, given: Given) -> list[Any]:
    """For each video everything that determines its decoded pictures, as JSON: the file's digest, the frames taken, size, crop and turn."""
    facts = Facts.of(capture.facts)
    size = [facts.width, facts.height]
    crops = [None if capture.crop is None else capture.crop[video.start].tolist() for video in capture.videos]
    turns = [[] if capture.turns is None else [capture.turns[video.start]] for video in capture.videos]
    return [[given.digests[v.file], list(v.taken), v.total, *size, c, *t] for v, c, t in zip(capture.videos, crops, turns, strict=True)]


def decode_videos(capture: Capture, ctx: Context) -> zarr.Array:
    """Writes the pictures of every video, and which rows belong to which video, so that later results can reuse them. Returns the pictures,
    [F, H, W, 3] uint8."""
    facts = Facts.of(capture.facts)
    images = create_images(ctx.out, facts.frames, facts.height, facts.width)
    taken = 0
    films: dict[str, tuple[Film, Sequence[str]]] = {}
    with ctx.progress(facts.frames, "decode") as progress:
        for number, video in enumerate(capture.videos):
            film = Film()
            films[video.file] = film, capture.names[video.start : video.start + len(video.taken)]
            if _taken_over(ctx, number, video, images, film):
                taken += 1
                progress.advance(len(video.taken), video.file)
                continue
            part = None if capture.crop is None else capture.crop[video.start]
            turn = 1 if capture.turns is None else capture.turns[video.start]
            for offset, picture in enumerate(decode(capture.root, video, facts.width, facts.height, part, ctx.log, turn)):
                images[video.start + offset] = picture
                film.add(small(picture))
                progress.advance(1, video.file)
    for line in told(films):
        ctx.log(line)
    if taken:
        ctx.log(f"{taken} of {len(capture.videos)} cameras as decoded before")
    write_videos(ctx.out, [(video.start, len(video.taken)) for video in capture.videos])
    return images


def _taken_over(ctx: Context, number: int, video: Video, images: zarr.Array, film: Film) -> bool:
    """Copies the pictures of a video from ``ctx.earlier``, and adds them to ``film``. Returns False if they are new or cannot be read."""
    if ctx.earlier is None or number not in ctx.earlier.rows:
        return False
    try:
        for offset, picture in enumerate(pictures_of_video(ctx.earlier.artifact, ctx.earlier.rows[number])):
            images[video.start + offset] = picture
            film.add(small(picture))
    except ArtifactError:  # it was intact a moment ago; decoding gives the right result in any case
        return False
    return True
