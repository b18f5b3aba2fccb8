"""Renders views and measures them against the captured pictures."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any

import cv2
import numpy as np
import torch

from ...pipeline import StageError
from ...rasterizer import Camera, Frame
from ...scene.metrics.edge_psnr import edge_psnr
from ...scene.metrics.lpips import Lpips
from ...scene.metrics.psnr import affine_fit, psnr
from ...scene.metrics.ssim import ssim
from ...scene.model import Model
from ...scene.motion.times import corrected
from ...vision.images.pictures import composite
from ..exports.capture_cameras import camera_of
from ..shared.posed_frameset import PosedFrameSet

OTHER = {"white": "black", "black": "white"}
FPS_RENDERS, FPS_SECONDS = 20, 10.0
MEDIAN_OF, LEAST_TIMES = 15, 5  # about 15 pictures of a fixed camera give its median, and at least 5 are needed to find moving pixels
MOVING_DIFFERENCE = 0.1  # in [0, 1], difference from the median in some channel above which a pixel is moving


class Judge:
    """Renders views of ``frames`` and measures them. fixed: the cameras are fixed, so moving pixels are also measured separately."""

    def __init__(self, model: Model, frames: PosedFrameSet, lpips: Lpips | None, fixed: bool) -> None:
        self.model, self.frames, self.lpips, self.fixed = model, frames, lpips, fixed
        self._medians: dict[int, np.ndarray] = {}  # by camera, of a few of its pictures

    def camera(self, i: int) -> Camera:
        return camera_of(self.model, self.frames, i)

    def moment(self, i: int) -> float:
        """Time of frame i in [0, 1], by what training found of its camera's clock."""
        return corrected(float(self.frames.time[i]), int(self.frames.camera[i]), self.model.clocks)

    def render(self, i: int, at: float | None = None) -> tuple[np.ndarray, Frame]:
        """Renders from frame i's camera at its own time, or at time ``at``: colour float32 [H, W, 3] clamped to [0, 1], and all outputs."""
        frame = self.model.render(self.camera(i), self.moment(i) if at is None else at)
        if not torch.isfinite(frame.color).all():
            raise StageError(
                f"evaluate: the render of frame {self.frames.names[i]!r} holds non-finite colours, so the model is damaged; "
                "train it again with --force, and look at nonfinite_steps of its training log"
            )
        frame = on_the_cpu(frame)
        return frame.color.clamp(0, 1).numpy(), frame

    def measured(self, i: int, color: np.ndarray, frame: Frame) -> dict[str, Any]:
        """Row of metrics of frame i, rendered with `render`. Any thread may call this."""
        truth = self.frames.composited(i).astype(np.float64) / 255.0
        kept = self.kept(i)
        if kept is not None:  # since windows of metrics reach into pixels that do not count
            color = np.where(kept[..., None], color, truth).astype(np.float32)
        row: dict[str, Any] = {
            "name": self.frames.names[i],
            "frame": int(i),
            "camera": int(self.frames.camera[i]),
            "time": float(self.frames.time[i]),
            "psnr": psnr(color, truth, kept),
            "ssim": ssim(color, truth, kept),
            "edge_psnr": edge_psnr(color, truth, kept),
            "lpips": None if self.lpips is None else self.lpips(color, truth),
        }
        if not self.frames.alpha:
            fitted = affine_fit(color, truth, kept)
            row |= {"psnr_affine": psnr(fitted, truth, kept), "ssim_affine": ssim(fitted, truth, kept)}
        if self.fixed:
            row |= self._of_motion(i, color, truth)
        if self.frames.alpha and self.frames.background is not None:
            row |= self._of_alpha(i, color, truth, frame)
        return row

    def _of_motion(self, i: int, color: np.ndarray, truth: np.ndarray) -> dict[str, float | None]:
        """PSNR of the moving and of the static pixels, if the fixed camera saw enough times to distinguish them, otherwise None."""
        camera = int(self.frames.camera[i])
        if camera not in self._medians:
            same = np.flatnonzero((self.frames.camera == camera) & self.frames.registered)
            pictures = [self.frames.composited(int(k)) for k in same[:: max(1, len(same) // MEDIAN_OF)]]
            self._medians[camera] = np.median(pictures, axis=0) / 255.0 if len(pictures) >= LEAST_TIMES else np.zeros(0)
        median = self._medians[camera]
        if not median.size:
            return {"psnr_moving": None, "psnr_static": None}
        moving = cv2.dilate((np.abs(truth - median).max(-1) > MOVING_DIFFERENCE).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
        kept = self.kept(i)
        both = {"psnr_moving": moving, "psnr_static": ~moving}
        both = both if kept is None else {name: mask & kept for name, mask in both.items()}
        return {name: psnr(color, truth, mask) if mask.any() else None for name, mask in both.items()}

    def _of_alpha(self, i: int, color: np.ndarray, truth: np.ndarray, frame: Frame) -> dict[str, float | None]:
        """Metrics for captures with alpha: PSNR where alpha is not 0, and PSNR on the background that was not trained on. A model that
        represents dark or bright surfaces as holes scores badly on the latter."""
        assert self.frames.background is not None
        picture = self.frames.image(i)
        filled = picture[..., 3] > 0
        other = OTHER[self.frames.background]
        behind = 1.0 if other == "white" else -1.0
        on_other = (frame.color.numpy() + behind * (1 - frame.alpha.numpy()[..., None])).clip(0, 1)
        kept = self.kept(i)
        filled = filled if kept is None else filled & kept
        return {
            "psnr_foreground": psnr(color, truth, filled) if filled.any() else None,
            "psnr_other_background": psnr(on_other, composite(picture, other) / 255.0, kept),
        }

    def kept(self, i: int) -> np.ndarray | None:
        """[H, W] bool, the pixels of frame i that are measured; None for all, also if the mask leaves no pixel."""
        kept = self.frames.kept(i)
        return kept if kept is not None and kept.any() else None

    def frames_per_second(self, indices: Sequence[int]) -> float:
        """1 / median time of up to `FPS_RENDERS` renders (deformation included) of the views ``indices``, after one warm-up render."""
        seconds: list[float] = []
        begin = time.perf_counter()
        for k in range(FPS_RENDERS + 1):
            i = indices[k % len(indices)]
            camera, at = self.camera(i), self.moment(i)
            start = time.perf_counter()
            self.model.render(camera, at)
            if self.model.device.type == "cuda":
                torch.cuda.synchronize()
            if k:
                seconds.append(time.perf_counter() - start)
            if seconds and time.perf_counter() - begin > FPS_SECONDS:
                break
        return round(1.0 / float(np.median(seconds)), 3)


def on_the_cpu(frame: Frame) -> Frame:
    """The same frame, with its tensors on the CPU."""
    return replace(frame, **{field.name: getattr(frame, field.name).cpu() for field in fields(frame)})
