"""The protocol of an evaluation, without which its numbers cannot be compared with others, and the network of LPIPS."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from blake3 import blake3

from ...pipeline import StageError
from ...scene.metrics.lpips import MINIMUM_SIZE, Lpips
from ...scene.metrics.published_lpips import Unavailable, published_lpips
from ..facts import STANDS_STILL
from ..shared.posed_frameset import PosedFrameSet
from .settings import EvaluateSettings


def load_lpips(settings: EvaluateSettings, frames: PosedFrameSet) -> tuple[Lpips | None, dict[str, str]]:
    """The network with the weights of a file, or else with the published ones; or None and the reason as `lpips_reason`. Raises StageError
    if the weights file is invalid."""
    if min(frames.width, frames.height) < MINIMUM_SIZE:
        return None, {"lpips_reason": f"pictures of {frames.width}x{frames.height} are smaller than the {MINIMUM_SIZE} px that LPIPS needs"}
    if settings.lpips_weights is None:
        try:
            return published_lpips(settings.lpips_net), {}
        except Unavailable as error:
            return None, {"lpips_reason": f"{error}, or name a file with evaluate.lpips_weights; then: e4dgs run evaluate CAPTURE --force"}
    try:
        return Lpips.load(settings.lpips_weights, settings.lpips_net), {}
    except ValueError as error:
        raise StageError(f"evaluate.lpips_weights: {error}") from error


def protocol(
    frames: PosedFrameSet,
    views: Mapping[str, Sequence[int]],
    settings: EvaluateSettings,
    lpips_facts: Mapping[str, str],
    notes: Sequence[str],
) -> dict[str, Any]:
    """Everything that must be known to compare the numbers of this evaluation with others."""
    measured = not lpips_facts
    result: dict[str, Any] = {
        "resolution": f"{frames.width}x{frames.height}",
        "split": ", ".join(f"{split} ({len(indices)} views)" for split, indices in views.items()),
        "background": frames.background,
        "lpips_net": settings.lpips_net if measured else None,
        "colours": "of the mean training camera; psnr_affine after one affine a channel and view",
        "moving": "of fixed cameras: pixels within 2 px of one that is more than 0.1 from the camera's median over time",
        "metrics": "float64 on clamped float renders; SSIM 11x11 Gaussian, sigma 1.5, zero padding; edges: Canny 50/100, within 2 px",
        "flicker": "fixed cameras, neighbouring times, in stretches of up to 16 times where there are many; excess change of the "
        "render, in levels of 8 bits; warped: along the truth's motion (Farneback), where it is above 0.5 px; flow: tOF in px",
        "notes": list(notes),
    }
    if frames.watermark is not None:
        result["watermark"] = (
            f"{float((frames.watermark > 0).mean()):.2%} of each picture stands still while the camera moves and is left out"
        )
    if frames.stands_still:
        result["limits"] = STANDS_STILL
    if frames.every_time > 1:
        result["times"] = (
            f"frames.every_time={frames.every_time}; test: training cameras at the times left out; val: what the files hold out"
        )
    if measured and settings.lpips_weights is None:
        result["lpips_weights"] = "published: trunk of torchvision, heads of lpips 0.1"
    elif measured and settings.lpips_weights is not None:
        result["lpips_weights_blake3"] = blake3(Path(settings.lpips_weights).read_bytes()).hexdigest()
    return result
