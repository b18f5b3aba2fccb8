"""Pictures of an evaluation: encoded as PNG, kept in one array, listed in attrs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ...pipeline import Artifact, ArtifactWriter
from ...vision.images.png import encode_png
from .edges_picture import edges_picture

if TYPE_CHECKING:
    from ...rasterizer import Frame

ERROR_GAIN = 4.0
STRIP_SIZE = 320  # px, longest side of a picture of the time strip


class PictureBook:
    """Collects pictures and writes them as `png`, `png_offsets`, attrs `png_names`, and attrs `views`, `strip` and `flow` that say what
    they show; `flow` is absent where nothing was measured.

    Names are "<split>/<frame>/truth|render|error|edges|depth", "strip/<k>/render|truth", and those of `flow_pictures.add_flow`.
    """

    def __init__(self, size: int) -> None:
        self.size = size
        self.names: list[str] = []
        self.encoded: list[bytes] = []
        self.views: list[dict[str, Any]] = []
        self.strip: dict[str, Any] = {"camera": "", "times": []}
        self.flow: dict[str, Any] = {}

    def add(self, name: str, picture: np.ndarray, size: int) -> None:
        """``picture``: uint8 [H, W, 3] RGB, scaled down to a longest side of ``size`` px."""
        self.names.append(name)
        self.encoded.append(encode_png(scaled(picture, size)))

    def add_view(self, split: str, name: str, time: float, truth: np.ndarray, frame: Frame, row: dict[str, Any]) -> None:
        """Ground truth uint8 [H, W, 3] beside the render, their difference, the edges of both, and the depth."""
        color = frame.color.clamp(0, 1).numpy()
        stem = f"{split}/{row['frame']}"
        shown = [scaled(picture, self.size) for picture in (truth, to_bytes(color))]
        self.add(f"{stem}/truth", shown[0], self.size)
        self.add(f"{stem}/render", shown[1], self.size)
        self.add(f"{stem}/error", error_picture(color, truth), self.size)
        self.add(f"{stem}/edges", edges_picture(shown[1], shown[0]), self.size)
        self.add(f"{stem}/depth", depth_picture(frame.depth.numpy(), frame.alpha.numpy()), self.size)
        self.views.append({"stem": stem, "split": split, "name": name, "time": time, "psnr": row["psnr"], "ssim": row["ssim"]})

    def add_strip(self, camera: str, items: list[tuple[float, np.ndarray, np.ndarray | None]]) -> None:
        """``items``: (time, render float [H, W, 3], ground truth uint8 [H, W, 3] or None)."""
        self.strip = {"camera": camera, "times": [time for time, _, _ in items]}
        for k, (_, render, truth) in enumerate(items):
            self.add(f"strip/{k}/render", to_bytes(render), STRIP_SIZE)
            if truth is not None:
                self.add(f"strip/{k}/truth", truth, STRIP_SIZE)

    def write(self, out: ArtifactWriter) -> None:
        out.write("png", np.frombuffer(b"".join(self.encoded), np.uint8), doc="PNG files, one after the other")
        out.write(
            "png_offsets", np.cumsum([0, *map(len, self.encoded)]).astype(np.int64), unit="byte", doc="where each begins, and the end"
        )
        out.attrs["png_names"] = self.names
        out.attrs["views"] = self.views
        out.attrs["strip"] = self.strip
        if self.flow:
            out.attrs["flow"] = self.flow


def read_pictures(artifact: Artifact) -> dict[str, bytes]:
    """PNG files of an `evaluate` artifact by name."""
    if "png" not in artifact:
        return {}
    data, offsets = artifact.read("png").tobytes(), artifact.read("png_offsets")
    return {name: data[offsets[k] : offsets[k + 1]] for k, name in enumerate(artifact.attrs.get("png_names", []))}


def scaled(picture: np.ndarray, size: int) -> np.ndarray:
    """``picture`` scaled down to a longest side of ``size`` px."""
    import cv2

    height, width = picture.shape[:2]
    if max(height, width) <= size:
        return picture
    scale = size / max(height, width)
    return cv2.resize(picture, (max(1, round(width * scale)), max(1, round(height * scale))), interpolation=cv2.INTER_AREA)


def to_bytes(color: np.ndarray) -> np.ndarray:
    """float [H, W, 3] in [0, 1] to uint8."""
    return np.rint(np.clip(color, 0.0, 1.0) * 255.0).astype(np.uint8)


def error_picture(color: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Mean absolute difference over channels, times 4, dark to bright: uint8 [H, W, 3] RGB."""
    import cv2

    error = np.abs(color - truth.astype(np.float32) / 255.0).mean(-1)
    scaled = to_bytes(ERROR_GAIN * error)
    return np.ascontiguousarray(cv2.applyColorMap(scaled, cv2.COLORMAP_INFERNO)[..., ::-1])


def depth_picture(depth: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Depth [H, W] from the 2nd to the 98th percentile of what is opaque, near is bright, faded to black by alpha [H, W]: uint8 RGB."""
    import cv2

    opaque = (alpha > 0.5) & np.isfinite(depth) & (depth > 0)
    if not opaque.any():
        return np.zeros((*depth.shape, 3), np.uint8)
    inverse = 1.0 / np.maximum(np.nan_to_num(depth, nan=np.inf), 1e-6)
    low, high = np.percentile(inverse[opaque], (2, 98))
    scaled = to_bytes((inverse - low) / max(float(high - low), 1e-12))
    colours = cv2.applyColorMap(scaled, cv2.COLORMAP_TURBO)[..., ::-1]
    return np.rint(colours * np.clip(np.nan_to_num(alpha), 0, 1)[..., None]).astype(np.uint8)
