"""Pictures and videos in one folder: photos with short clips of a phone, a video with its poster, or a question."""

from __future__ import annotations

import posixpath
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from ....pipeline import CaptureError
from .kinds import kind_of
from .names import in_order, is_image, is_video

_POSTER = ("poster", "thumb", "thumbnail", "thumbnails", "cover", "preview", "folder", "fanart", "screenshot", "artwork")
_CLIP = ".mov"  # of phones that write one beside each photo


def chosen(root: Path, names: Sequence[str]) -> Literal["images", "video", "videos"] | None:
    """ "images", "video" or "videos" for a folder whose files, `names`, are pictures and videos; None if it has only one of them, or none.

    Raises CaptureError, which names `--format`, if both are plausible, and if the pictures are of kinds that cannot be read."""
    videos = in_order(name for name in names if is_video(name))
    if not videos:
        return None
    photos = in_order(name for name in names if (kind := kind_of(name)) is not None and kind.group == "picture")
    readable = [name for name in photos if is_image(name)]
    if len(readable) > 1:  # a moving picture beside photos is no recording
        videos = [name for name in videos if not name.lower().endswith(".gif")]
    if not videos or not photos:
        return None
    one: Literal["video", "videos"] = "video" if len(videos) == 1 else "videos"
    stems = {_stem(name) for name in photos}
    paired = all(_stem(name) in stems for name in videos)
    if len(photos) > 1 and paired and all(name.lower().endswith(_CLIP) for name in videos):
        return _live(root, videos, photos, readable)
    if len(photos) == 1 or all(_is_poster(name, videos, len(photos)) for name in photos):
        return one
    pictures = f"{len(photos)} pictures (first {photos[0]})"
    kind = kind_of(photos[0])
    closed = "" if len(readable) > 1 or kind is None or not kind.advice else f" once they can be read: {kind.advice}"
    what = f"the video {videos[0]}" if one == "video" else f"{len(videos)} videos (first {videos[0]})"
    raise CaptureError(
        f"{root}: it has {what} and {pictures}; choose with --format {one}, or with --format images for the pictures{closed}"
    )


def alone(file: Path) -> bool:
    """Whether the video ``file`` is what its folder is about, so that what else lies there belongs to it: there is no other video, and
    there are no photos but stills of it."""
    try:
        names = [entry.name for entry in file.parent.iterdir() if not entry.name.startswith(".") and entry.is_file()]
        return [name for name in names if is_video(name)] == [file.name] and chosen(file.parent, names) in (None, "video")
    except (OSError, CaptureError):  # it cannot be listed, or the photos may be what the folder is about
        return False


def _live(root: Path, videos: Sequence[str], photos: Sequence[str], readable: Sequence[str]) -> Literal["images"]:
    if len(readable) > 1:
        return "images"
    kind = kind_of(photos[0])
    raise CaptureError(
        f"{root}: {len(photos)} photos (first {photos[0]}) with a clip of the same name for {len(videos)} of them (first {videos[0]}), as "
        f"phones take them, and {'none' if not readable else 'only one'} of the photos is of a kind that is read; "
        + (f"{kind.advice}" if kind is not None and kind.advice else "convert them to JPEG")
        + f", or choose --format {'video' if len(videos) == 1 else 'videos'} if the clips are meant"
    )


def _is_poster(name: str, videos: Sequence[str], photos: int) -> bool:
    """Whether a picture is a still of a video rather than a photo of its own."""
    words = re.findall(r"[a-z]+", _stem(name))
    return any(word in _POSTER for word in words) or (photos <= 2 and any(_stem(name).startswith(_stem(video)) for video in videos))


def _stem(name: str) -> str:
    return posixpath.splitext(name)[0].lower()
