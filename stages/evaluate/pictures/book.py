"""Pictures of an evaluation, encoded as PNG."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from ....rasterizer import Frame
from ....vision.images.pictures import shrunk
from ....vision.images.png import encode_png
from ..artifact import StoredPictures
from .edges import edges_picture

ERROR_GAIN = 4.0
STRIP_SIZE = 320  # px, longest side of a picture of the time strip


class PictureBook:
    """Collects the pictures of an evaluation in `stored`. The longest side of pictures of views is at most ``size`` px."""

    def __init__(self, size: int) -> None:
        self.size = size
        self.stored = StoredPictures()

    def add(self, name: str, picture: np.ndarray, size: int) -> None:
        """``picture``: uint8 [H, W, 3] RGB, scaled down to a longest side of ``size`` px."""
        self.stored.files[name] = encode_png(shrunk(picture, size))

    def add_view(
        self, split: str, name: str, time: float, truth: np.ndarray, frame: Frame, row: dict[str, Any], kept: np.ndarray | None = None
    ) -> None:
        """Adds the ground truth ``truth``, uint8 [H, W, 3], the render, their difference where it is measured (``kept`` [H, W] bool, None:
        everywhere), the edges of both, and the depth."""
        color = frame.color.clamp(0, 1).numpy()
        stem = f"{split}/{row['frame']}"
        shown = [shrunk(picture, self.size) for picture in (truth, to_bytes(color))]
        self.add(f"{stem}/truth", shown[0], self.size)
        self.add(f"{stem}/render", shown[1], self.size)
        self.add(f"{stem}/error", error_picture(color, truth, kept), self.size)
        self.add(f"{stem}/edges", edges_picture(shown[1], shown[0]), self.size)
        self.add(f"{stem}/depth", depth_picture(frame.depth.numpy(), frame.alpha.numpy()), self.size)
        view = {"stem": stem, "split": split, "name": name, "time": time, "psnr": row["psnr"], "ssim": row["ssim"]}
        self.stored.views.append(view | {"depth_range": depth_range(frame.depth.numpy(), frame.alpha.numpy())})

    def add_strip(self, camera: str, items: list[tuple[float, np.ndarray, np.ndarray | None]]) -> None:
        """``items``: (time, render float [H, W, 3], ground truth uint8 [H, W, 3] or None)."""
        self.stored.strip = {"camera": camera, "times": [time for time, _, _ in items]}
        for k, (_, render, truth) in enumerate(items):
            self.add(f"strip/{k}/render", to_bytes(render), STRIP_SIZE)
            if truth is not None:
                self.add(f"strip/{k}/truth", truth, STRIP_SIZE)


def to_bytes(color: np.ndarray) -> np.ndarray:
    """float [H, W, 3] in [0, 1] to uint8."""
    return np.rint(np.clip(color, 0.0, 1.0) * 255.0).astype(np.uint8)


def error_picture(color: np.ndarray, truth: np.ndarray, kept: np.ndarray | None = None) -> np.ndarray:
    """Mean absolute difference over channels, times `ERROR_GAIN`, as colours from dark to bright: uint8 [H, W, 3] RGB. It is zero where not
    ``kept`` [H, W] bool."""
    error = np.abs(color - truth.astype(np.float32) / 255.0).mean(-1)
    error = error if kept is None else np.where(kept, error, 0.0)
    scaled = to_bytes(ERROR_GAIN * error)
    return np.ascontiguousarray(cv2.applyColorMap(scaled, cv2.COLORMAP_INFERNO)[..., ::-1])


def depth_range(depth: np.ndarray, alpha: np.ndarray) -> list[float] | None:
    """[nearest, farthest] depth of the colours of `depth_picture`, world units: the 2nd and the 98th percentile of the opaque pixels; None
    without any."""
    opaque = (alpha > 0.5) & np.isfinite(depth) & (depth > 0)
    if not opaque.any():
        return None
    low, high = np.percentile(1.0 / np.maximum(depth[opaque], 1e-6), (2, 98))
    return [float(1.0 / high), float(1.0 / low)]


def depth_picture(depth: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Inverse depth as colours, uint8 [H, W, 3] RGB, faded to black by alpha [H, W]. The colours span `depth_range`."""
    span = depth_range(depth, alpha)
    if span is None:
        return np.zeros((*depth.shape, 3), np.uint8)
    inverse = 1.0 / np.maximum(np.nan_to_num(depth, nan=np.inf), 1e-6)
    low, high = 1.0 / span[1], 1.0 / span[0]
    scaled = to_bytes((inverse - low) / max(float(high - low), 1e-12))
    colours = cv2.applyColorMap(scaled, cv2.COLORMAP_TURBO)[..., ::-1]
    return np.rint(colours * np.clip(np.nan_to_num(alpha), 0, 1)[..., None]).astype(np.uint8)
