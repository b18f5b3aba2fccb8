"""The work of `frames`: decodes the capture's pictures and writes the metadata of every frame."""

from __future__ import annotations

import numpy as np

from ...pipeline import CaptureError, Context
from ...vision.images.lenses import pinholes
from ..captures import Capture
from ..facts import Facts
from .artifact import StoredFrames
from .pictures import check_pictures
from .videos import decode_videos
from .watermark import watermark_of


def decode_capture(capture: Capture, ctx: Context) -> None:
    """Decodes videos into the artifact. Image files are decoded only to check that they are intact."""
    for note in capture.notes:
        ctx.log(note)
    decoded = None
    if capture.images is None:
        decoded = decode_videos(capture, ctx)
    else:
        check_pictures(capture, ctx)
    _write(capture, ctx, watermark_of(capture, ctx, decoded))


def _write(capture: Capture, ctx: Context, watermark: np.ndarray | None) -> None:
    """Writes the metadata of every frame."""
    K = None
    if capture.K is not None and capture.distortion is not None:
        K = _pinholes(capture, capture.K, capture.distortion, ctx)
    StoredFrames(
        facts=Facts.of(capture.facts),
        names=capture.names,
        background=capture.background,
        camera=capture.camera,
        time=capture.time,
        seconds=capture.seconds,
        split=capture.split,
        next=capture.next,
        K=K,
        cam_from_world=capture.cam_from_world,
        distortion=capture.distortion,
        lens_K=capture.K if K is not None and (K != capture.K).any() else None,
        fisheye=None if K is None else capture.fisheye,
        crop=capture.crop,
        watermark=watermark,
        points=capture.points,
        point_colors=capture.point_colors,
        files=capture.images,
        mask_files=capture.masks,
        keep_files=capture.keeps,
        keep_turns=None if capture.keeps is None else capture.keep_turns or (),
        turns=capture.turns,
        depth_files=capture.depths,
        depth_confidence_files=capture.depth_confidences,
        origin=None if capture.origin is None else capture.origin.tolist(),
        K_hint=capture.K_hint,
    ).write(ctx.out, capture.notes)


def _pinholes(capture: Capture, K: np.ndarray, distortion: np.ndarray, ctx: Context) -> np.ndarray:
    """K of the pinhole cameras to which the pictures are undistorted. Logs how much of the pictures remains."""
    facts = Facts.of(capture.facts)
    result, kept = pinholes(K, distortion, capture.fisheye, facts.width, facts.height)
    if not kept.all():
        i = int(kept.argmin())
        raise CaptureError(
            f"{capture.names[i]}: distortion: the lens's terms {distortion[i].tolist()} fold the picture over or leave too little of it; "
            "correct the calibration, or undistort the images first"
        )
    bent = np.asarray(distortion.any(1))
    if capture.fisheye is not None:
        bent |= capture.fisheye > 0
    if bent.any():
        ctx.log(
            f"{bent.sum()} of {len(bent)} pictures are undistorted to pinhole cameras; they keep "
            f"at least {kept[bent].min():.0%} of a picture's area, every pixel of it seen by the lens"
        )
    return result
