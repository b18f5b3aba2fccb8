"""Opens untrusted video files: only video containers, no access to other files or addresses, and sizes within bounds."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ...pipeline import CaptureError

MOST_PIXELS = 2**27  # of a picture: 16K, 0.2 GB when decoded
MOST_FRAMES = 1_000_000  # nine hours
# A list of allowed containers, since FFmpeg also opens lists of other files and addresses (HLS, concat, DASH, SDP), and plays text files
# and programs as videos.
_CONTAINERS = (
    "mov,matroska,webm,avi,mpeg,mpegts,mpegvideo,ogg,flv,asf,gif,apng,mxf,mxf_opatom,dv,rm,ivf,nut"
    ",wtv,yuv4mpegpipe,m4v,mjpeg,h261,h263,h264,hevc,vvc,vc1,av1,obu,dirac,r3d,amv"
)


@contextmanager
def open_video(root: Path, name: str) -> Iterator[Any]:
    """PyAV's container of `root/name`, closed at the end. Errors of PyAV pass through to the caller. Raises CaptureError if it is not a
    file, or if pictures are larger than `MOST_PIXELS`."""
    import av

    path = root / name
    if not path.is_file():  # opening a pipe would block
        raise CaptureError(f"{name}: not a file; pass a video file")
    with av.open(str(path), options={"protocol_whitelist": "file", "format_whitelist": _CONTAINERS}) as container:
        for stream in container.streams.video:
            context = stream.codec_context
            if context is None:  # unknown codec
                continue
            if context.width * context.height > MOST_PIXELS:
                raise CaptureError(f"{name}: pictures of {context.width}x{context.height} are too large; scale the video down")
            context.options = {**context.options, "max_pixels": str(MOST_PIXELS)}  # the pictures may declare another size
        yield container
