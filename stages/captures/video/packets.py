"""The packets of a video track. Reading them decodes nothing, so it takes a long video as fast as the disk gives it."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ....pipeline import CaptureError
from ..video_files import MOST_FRAMES
from .hidden import is_hidden, may_be_empty
from .length import is_cut_short

_LARGE = 10 * 2**30  # bytes
_LEAST_USED = 0.01  # least share of a large file that must be video data


@dataclass
class Packets:
    """Packets that should each give a picture, in the order of the file. stamps: time stamps in ticks, None where the file gives none.
    trimmed: pictures that an edit list hides. doubtful: some packet may give no picture, and only decoding tells."""

    stamps: list[int | None] = field(default_factory=list)
    sizes: int = 0  # bytes
    trimmed: int = 0
    doubtful: bool = False


def read_packets(container: Any, stream: Any, path: Path, name: str) -> Packets:
    """Raises CaptureError for damaged files, for those cut short, and for more than `MOST_FRAMES` frames."""
    found, there, codec = Packets(), 0, stream.codec_context.name
    for packet in container.demux(stream):
        there += packet.size > 0
        if not packet.size:  # AVI fills gaps with empty packets
            continue
        if packet.is_discard:  # an edit list discards what was trimmed without encoding again
            found.trimmed += 1
            continue
        if packet.is_corrupt and found.stamps:
            joined = ", or join its parts with ffmpeg's concat demuxer" if "mpegts" in container.format.name else ""
            raise CaptureError(f"{name}: frame {len(found.stamps)}: the file is damaged or cut short here; copy it again{joined}")
        found.sizes += packet.size
        if is_hidden(codec, packet):
            continue
        found.doubtful |= may_be_empty(codec, packet.size)
        found.stamps.append(packet.pts)
        if len(found.stamps) > MOST_FRAMES:
            raise CaptureError(f"{name}: more than {MOST_FRAMES} frames; cut the video to the part that you mean")
    # MP4's count of samples includes those that an edit list hides, so the index decides there. AVI's count includes empty packets.
    counts = "mov" in container.format.name.split(",")
    if is_cut_short(path) or (counts and there < min(stream.frames, len(stream.index_entries))):
        raise CaptureError(f"{name}: frame {len(found.stamps)}: the file promises more and ends here, cut short; copy it again")
    size = path.stat().st_size
    if size > _LARGE and found.sizes < _LEAST_USED * size:  # every command reads the whole file to see whether it changed
        raise CaptureError(
            f"{name}: {found.sizes} bytes of pictures in a file of {size / 1e9:.0f} GB, damaged; copy it again or convert it to MP4"
        )
    if not found.stamps:
        raise CaptureError(f"{name}: holds no frames; copy or record the video again")
    if counts and stream.frames:  # an index with several edits has some packets twice, to decode what follows
        found.trimmed = max(0, stream.frames - len(found.stamps))
    return found
