"""Writes pictures as an MP4, whose colours every player shows as they are."""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ...pipeline.files import written_beside

BROADCAST = 5e-3  # frames a second by which 23.98 or 29.97 may miss the rate that it stands for
LEAST_BROADCAST = 24  # frames a second; slower movies are never meant to be 1.001 times slower
BT709 = 1  # its primaries and its transfer curve, by ITU-T H.273
QUALITY = 18  # x264's constant rate factor: hard to tell from the original


class Encoder:
    """Encodes H.264 that plays in every browser, to a file or to memory: `add` pictures, then `close`.

    A picture is uint8 [H, W, 3]. The format needs even sizes (see `even`), so the last row or column of an odd number is left out, and a
    single one is repeated. ``fps`` may be a broadcast rate, such as 29.97 for 30000/1001. Pixels are those of ITU-R BT.709 in the range of
    television, and the stream says so: without tags players take small pictures for BT.601 and large ones for BT.709.
    """

    def __init__(self, target: str | BinaryIO, fps: float, quality: int = QUALITY) -> None:
        import av
        from av.video.reformatter import ColorRange, Colorspace

        # The index goes to the front, so that the movie plays while it loads. That needs a file that can be opened again.
        options = {"movflags": "+faststart"} if isinstance(target, str) else {}
        self._container = av.open(target, "w", format="mp4", options=options)
        self._stream = self._container.add_stream("libx264", rate=exact_rate(fps))
        self._stream.pix_fmt = "yuv420p"
        codec = self._stream.codec_context
        codec.colorspace, codec.color_range = Colorspace.ITU709, ColorRange.MPEG
        codec.color_primaries = codec.color_trc = BT709
        # With x264's macroblock tree the same pictures gave different bytes in every run (seen on AMD EPYC); without it they do not.
        self._stream.options = {"crf": str(quality), "x264-params": "mbtree=0"}
        self._begun = False

    def add(self, picture: np.ndarray) -> None:
        import av
        from av.video.reformatter import ColorRange, Colorspace, Interpolation

        for axis in (0, 1):
            if picture.shape[axis] == 1:
                picture = np.repeat(picture, 2, axis)
        height, width = (size - size % 2 for size in picture.shape[:2])
        if not self._begun:
            self._stream.width, self._stream.height, self._begun = width, height, True
        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture[:height, :width]), format="rgb24")
        # Not left to the encoder, which converts by BT.601 whatever the tags say.
        converted = frame.reformat(
            format="yuv420p",
            dst_colorspace=Colorspace.ITU709,
            src_color_range=ColorRange.JPEG,
            dst_color_range=ColorRange.MPEG,
            interpolation=Interpolation.BICUBIC | Interpolation.ACCURATE_RND | Interpolation.FULL_CHR_H_INP,
        )
        self._container.mux(self._stream.encode(converted))

    def close(self, whole: bool = True) -> None:
        """Closes the file. ``whole`` False drops frames not written yet, for a file that will be thrown away."""
        if whole:
            self._container.mux(self._stream.encode())
        self._container.close()


def even(size: int) -> int:
    """The largest size in px that a movie can have and that is not above ``size``; at least 2."""
    return max(2, size - size % 2)


def exact_rate(fps: float) -> Fraction:
    """``fps`` as a movie states it: a rate of 24, 30, 60 and so on over 1.001 is meant where it is written with two or three decimals."""
    of_film = round(1.001 * fps)
    if of_film >= LEAST_BROADCAST and round(fps, 3) != round(fps) and abs(1.001 * fps - of_film) < BROADCAST:
        return Fraction(1000 * of_film, 1001)
    return Fraction(fps).limit_denominator(1001)


def encode_movie(pictures: Iterable[np.ndarray], fps: float, quality: int = QUALITY) -> bytes:
    """An MP4 file of ``pictures``, uint8 [H, W, 3] each."""
    file = io.BytesIO()
    encoder = Encoder(file, fps, quality)
    for picture in pictures:
        encoder.add(picture)
    encoder.close()
    return file.getvalue()


@contextmanager
def movie_file(path: Path, fps: float) -> Iterator[Encoder]:
    """``with movie_file(path, fps) as movie: movie.add(picture)``: the file appears only when complete."""
    with written_beside(path) as part:
        movie, whole = Encoder(str(part.absolute()), fps), False  # what comes before a : in a relative name would be a protocol
        try:
            yield movie
            whole = True
        finally:
            movie.close(whole)
