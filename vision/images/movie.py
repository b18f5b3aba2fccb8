"""Writes pictures as an MP4, or as a folder of numbered PNG and depth files."""

from __future__ import annotations

import importlib.util
import io
import os
import shutil
import tempfile
from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import BinaryIO

import numpy as np

from ...pipeline import StageError

BROADCAST = 5e-3  # frames a second by which 23.98 or 29.97 may miss the rate that it stands for
LEAST_BROADCAST = 24  # frames a second; slower movies are never meant to be 1.001 times slower
QUALITY = 18  # x264's constant rate factor: hard to tell from the original


class Encoder:
    """Encodes H.264 that plays in every browser, to a file or to memory: `add` pictures, then `close`.

    A picture is uint8 [H, W, 3]. The format needs even sizes, so the last row or column of an odd number is left out, and a single one is
    repeated. ``fps`` may be a broadcast rate, such as 29.97 for 30000/1001.
    """

    def __init__(self, target: str | BinaryIO, fps: float, quality: int = QUALITY) -> None:
        import av

        # The index goes to the front, so that the movie plays while it loads. That needs a file that can be opened again.
        options = {"movflags": "+faststart"} if isinstance(target, str) else {}
        self._container = av.open(target, "w", format="mp4", options=options)
        self._stream = self._container.add_stream("libx264", rate=exact_rate(fps))
        self._stream.pix_fmt = "yuv420p"
        # With x264's macroblock tree the same pictures gave different bytes in every run (seen on AMD EPYC); without it they do not.
        self._stream.options = {"crf": str(quality), "x264-params": "mbtree=0"}
        self._begun = False

    def add(self, picture: np.ndarray) -> None:
        import av

        for axis in (0, 1):
            if picture.shape[axis] == 1:
                picture = np.repeat(picture, 2, axis)
        height, width = (size - size % 2 for size in picture.shape[:2])
        if not self._begun:
            self._stream.width, self._stream.height, self._begun = width, height, True
        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture[:height, :width]), format="rgb24")
        self._container.mux(self._stream.encode(frame))

    def close(self, whole: bool = True) -> None:
        """Closes the file. ``whole`` False drops frames not written yet, for a file that will be thrown away."""
        if whole:
            self._container.mux(self._stream.encode())
        self._container.close()


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


class Movie:
    """``with Movie(path, fps) as movie: movie.add(picture, depth)``: a file as from `Encoder`, which appears only when complete."""

    def __init__(self, path: Path, fps: float) -> None:
        self.path, self.fps = path, fps

    def __enter__(self) -> Movie:
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self._part = self.path.with_name(f".{self.path.stem}-{os.getpid()}.mp4")
        self._encoder = Encoder(str(self._part), self.fps)
        return self

    def add(self, picture: np.ndarray, depth: np.ndarray) -> None:
        """The next picture; ``depth`` is not shown."""
        self._encoder.add(picture)

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        try:
            self._encoder.close(kind is None)
            if kind is None:
                os.replace(self._part, self.path)
        finally:
            self._part.unlink(missing_ok=True)


class Pictures:
    """``with Pictures(folder, depth) as pictures: ...``: ``0000.png``, ``0001.png`` and so on, with ``0000.exr`` where ``depth`` is wanted
    (channel Z, float32, world units along the optical axis, 0 where nothing is). The folder appears only when it is complete.

    Raises StageError if the folder already holds something, or the package for EXR is missing.
    """

    def __init__(self, folder: Path, depth: bool) -> None:
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise StageError(f"{folder}: already holds something; name a folder that does not exist or is empty")
        if depth and importlib.util.find_spec("OpenEXR") is None:
            raise StageError("--depth needs the package OpenEXR; install it with: pip install 'e4dgs[exr]'")
        self.folder, self.depth, self._count = folder, depth, 0

    def __enter__(self) -> Pictures:
        self.folder.parent.mkdir(parents=True, exist_ok=True)
        self._part = Path(tempfile.mkdtemp(prefix=f".{self.folder.name}-", dir=self.folder.parent))
        return self

    def add(self, picture: np.ndarray, depth: np.ndarray) -> None:
        """The next picture, uint8 [H, W, 3], and its ``depth`` [H, W]."""
        from PIL import Image

        Image.fromarray(picture).save(self._part / f"{self._count:04d}.png")
        if self.depth:
            import OpenEXR

            header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
            channels = {"Z": np.ascontiguousarray(depth, np.float32)}
            OpenEXR.File(header, channels).write(str(self._part / f"{self._count:04d}.exr"))
        self._count += 1

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if kind is not None:
            shutil.rmtree(self._part, ignore_errors=True)
            return
        self._part.chmod(0o755)
        if self.folder.exists():
            self.folder.rmdir()
        os.replace(self._part, self.folder)
