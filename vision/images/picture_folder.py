"""Writes rendered pictures as a folder of numbered PNG files, with alpha, masks and depth if wanted."""

from __future__ import annotations

import errno
import importlib.util
import os
import shutil
import tempfile
from pathlib import Path
from types import TracebackType

import numpy as np

from ...pipeline import SettingsError, StageError

NOTHING = (
    1e10  # depth where there is nothing, as Blender writes it: farther than anything, so that a merge by depth takes the other picture
)
MASKS = "masks"
PART = ".render-"  # begins the name of the folder that holds pictures until all are there
DEPTH_MEANS = (
    "Z: distance along the optical axis (planar depth) in units of the capture's world, mean of what a pixel blends; 1e10 where alpha is 0"
)
COLOUR_MEANS = "RGB: linear light of sRGB primaries, multiplied by alpha (premultiplied); A: alpha"


class PictureFolder:
    """``with PictureFolder(folder, depth, alpha) as pictures: pictures.add(...)``: ``0000.png``, ``0001.png`` and so on.

    alpha: the PNG files are RGBA with straight alpha, and ``masks/0000.png`` is alpha alone. depth: ``0000.exr`` beside each, float32
    channel Z: world units along the optical axis, `NOTHING` where nothing is; with ``alpha`` also R, G, B, A: half floats, linear light,
    premultiplied, as compositing programs expect of EXR. The header says what the channels mean. The pictures appear only when complete.

    Raises SettingsError if the folder already holds something, or the package for EXR is missing; at the end StageError, with the place
    where the pictures are, if they cannot go to the folder.
    """

    def __init__(self, folder: Path, depth: bool = False, alpha: bool = False) -> None:
        if folder.exists() and (not folder.is_dir() or _holds_something(folder)):
            raise SettingsError(f"{folder}: already holds something; name a folder that does not exist or is empty")
        if depth and importlib.util.find_spec("OpenEXR") is None:
            raise SettingsError("--depth needs the package OpenEXR; install it with: pip install 'e4dgs[exr]'")
        self.folder, self.depth, self.alpha, self._count = folder, depth, alpha, 0

    def __enter__(self) -> PictureFolder:
        whole = self.folder.resolve()  # a link may lead to a folder that is not there
        # No other folder can take the place of a mount or of the current folder, and the parent may be one that cannot be written.
        self._inside = whole.exists()
        place = whole if self._inside else whole.parent
        place.mkdir(parents=True, exist_ok=True)
        self._part = Path(tempfile.mkdtemp(prefix=PART, dir=place))
        if self.alpha:
            (self._part / MASKS).mkdir()
        return self

    def add(self, color: np.ndarray, alpha: np.ndarray, depth: np.ndarray) -> None:
        """The next picture. color: float [H, W, 3] in [0, 1]; on black if the folder is one with alpha, that is, multiplied by ``alpha``
        [H, W]. depth: [H, W], anything where alpha is 0."""
        from PIL import Image

        name = f"{self._count:04d}"
        if self.alpha:
            color = np.clip(color / np.maximum(alpha, 1e-6)[..., None], 0.0, 1.0)  # straight: 0 where nothing is
            mask = _bytes(alpha)
            Image.fromarray(np.dstack([_bytes(color), mask])).save(self._part / f"{name}.png")
            Image.fromarray(mask).save(self._part / MASKS / f"{name}.png")
        else:
            Image.fromarray(_bytes(color)).save(self._part / f"{name}.png")
        if self.depth:
            import OpenEXR

            channels = {"Z": np.where(alpha > 0, depth, NOTHING).astype(np.float32)}
            if self.alpha:
                shown = linear(color) * alpha[..., None]
                channels |= {key: np.ascontiguousarray(shown[..., k], np.float16) for k, key in enumerate("RGB")}
                channels["A"] = alpha.astype(np.float16)
            means = f"{DEPTH_MEANS}. {COLOUR_MEANS}." if self.alpha else f"{DEPTH_MEANS}."
            header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, "comments": means}
            header |= {"depthUnit": "world unit of the capture", "depthKind": "planar", "depthOfNothing": NOTHING}
            OpenEXR.File(header, channels).write(str(self._part / f"{name}.exr"))
        self._count += 1

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if kind is not None:
            shutil.rmtree(self._part, ignore_errors=True)
            return
        try:
            self._part.chmod(0o755)
            self._publish()
        except OSError as error:
            raise StageError(
                f"render: {self.folder}: the pictures cannot go there ({error.strerror}); they are in {self._part}, move them from there"
            ) from error

    def _publish(self) -> None:
        whole = self.folder.resolve()
        if not self._inside:
            os.replace(self._part, whole)
            return
        if _holds_something(whole):
            raise OSError(errno.ENOTEMPTY, os.strerror(errno.ENOTEMPTY), str(whole))
        for file in sorted(self._part.iterdir()):
            os.replace(file, whole / file.name)
        self._part.rmdir()


def _holds_something(folder: Path) -> bool:
    """Whether a folder holds more than the parts of renders that are at work or were killed."""
    return any(not one.name.startswith(PART) for one in folder.iterdir())


def linear(color: np.ndarray) -> np.ndarray:
    """Linear light of sRGB values in [0, 1] (IEC 61966-2-1)."""
    return np.where(color <= 0.04045, color / 12.92, ((color + 0.055) / 1.055) ** 2.4)


def _bytes(values: np.ndarray) -> np.ndarray:
    return np.rint(np.clip(values, 0.0, 1.0) * 255.0).astype(np.uint8)
