"""The pictures that the viewer can show of one view at one time: chosen primitives, drawn as colour, depth, flow or edges."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import cv2
import numpy as np
import torch
from torch import Tensor

from ...rasterizer import Camera, Convexes, Gaussians, rasterize
from ...scene.edges import edge_mask_canny
from ...scene.losses.flow_loss import project, rendered_flow
from ...scene.model import Model
from ...stages.evaluate.pictures.book import depth_picture, to_bytes
from ...vision.flow.colours import flow_colours

PRIMITIVES = ("all", "Gaussians", "convexes", "dynamic", "static")
LOOKS = ("colour", "depth", "flow", "edges")
FLOW_STEP = 1 / 30  # of the capture's time; flow is shown from the current moment to this much later
OUTLINE = (255, 60, 200)
EDGE = (255, 210, 0)

Drawn = TypeVar("Drawn", Gaussians, Convexes)


def picture(model: Model, camera: Camera, time: float, look: str = "colour", primitives: str = "all", outlines: bool = False) -> np.ndarray:
    """Renders ``camera`` at ``time`` in [0, 1]: uint8 [H, W, 3] RGB. look: one of `LOOKS`. primitives: one of `PRIMITIVES`. outlines: also
    draw the outline of each convex."""
    with torch.no_grad():
        if look == "flow":
            start = min(time, 1 - FLOW_STEP)
            flow, alpha = rendered_flow(model, camera, start, camera, start + FLOW_STEP, named(model, primitives))
            shown = flow_colours(torch.where(alpha[..., None] > 0.5, flow, 0.0).cpu().numpy())
        else:
            frame = rasterize(
                camera, *chosen(model, camera, time, primitives), torch.tensor(model.background), antialiased=model.antialiased
            )
            shown = to_bytes(frame.color.cpu().numpy())
            if look == "depth":
                shown = depth_picture(frame.depth.cpu().numpy(), frame.alpha.cpu().numpy())
            elif look == "edges":
                edges = edge_mask_canny(shown)
                shown = (shown * 0.35).astype(np.uint8)
                shown[edges] = EDGE
        if outlines:
            draw_outlines(shown, model, camera, time)
    told = absent(model, look, primitives, outlines)
    return shown if told is None else written_on(shown, told)


def absent(model: Model, look: str, primitives: str, outlines: bool) -> str | None:
    """Why a picture with these choices lacks what was chosen, whatever the view and the time: a line. None if it need not lack anything."""
    gaussians, convexes = len(model.gaussians), len(model.convexes)
    keep = named(model, primitives)
    chosen = gaussians + convexes if keep is None else int(keep[0].sum()) + int(keep[1].sum())
    if not chosen:
        return {
            "all": "this model is empty",
            "Gaussians": "this model has no Gaussians",
            "convexes": "this model has no convexes",
            "dynamic": "nothing moves in this model",
            "static": "nothing stands still in this model",
        }[primitives]
    moving = int(model.gaussians.dynamic.sum()) + int(model.convexes.dynamic.sum())
    if look == "flow" and (model.motion.static or not moving or primitives == "static"):
        return "no flow: nothing of what is shown moves"
    return "this model has no convexes to outline" if outlines and not convexes else None


def written_on(picture: np.ndarray, text: str) -> np.ndarray:
    """``picture`` with a line of text near its lower edge, dark on a light band so that it can be read on any picture."""
    height, width = picture.shape[:2]
    scale = 0.8 * width / max(cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 1.0, 1)[0][0], 1)
    scale = min(scale, height / 500)
    (across, up), below = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, scale, 1)
    place, pad = ((width - across) // 2, round(0.9 * height)), max(round(0.5 * up), 2)
    result = np.ascontiguousarray(picture).copy()
    corners = (place[0] - pad, place[1] - up - pad), (place[0] + across + pad, place[1] + below + pad)
    cv2.rectangle(result, *corners, (250, 250, 250), cv2.FILLED)
    cv2.putText(result, text, place, cv2.FONT_HERSHEY_SIMPLEX, scale, (20, 20, 20), 1, cv2.LINE_AA)
    return result


def chosen(model: Model, camera: Camera, time: float, primitives: str) -> tuple[Gaussians, Convexes]:
    """The model's primitives at ``time`` that ``primitives``, one of `PRIMITIVES`, names."""
    gaussians, convexes = model.at(time, camera)
    keep = named(model, primitives)
    return (gaussians, convexes) if keep is None else (_rows(gaussians, keep[0]), _rows(convexes, keep[1]))


def named(model: Model, primitives: str) -> tuple[Tensor, Tensor] | None:
    """Which Gaussians [N] and convexes [M] ``primitives`` names, bool; None for all."""
    g, c = model.gaussians.dynamic, model.convexes.dynamic
    return {
        "all": None,
        "Gaussians": (torch.ones_like(g), torch.zeros_like(c)),
        "convexes": (torch.zeros_like(g), torch.ones_like(c)),
        "dynamic": (g, c),
        "static": (~g, ~c),
    }[primitives]


def _rows(kind: Drawn, keep: Tensor) -> Drawn:
    return replace(kind, **{name: value[keep] for name, value in vars(kind).items() if isinstance(value, Tensor)})


def draw_outlines(picture: np.ndarray, model: Model, camera: Camera, time: float) -> None:
    """Draws the hull of each convex's projected points into ``picture``, except for convexes that reach behind the near plane."""
    points = model.at(time, camera)[1].points
    if not len(points):
        return
    corners = project(camera, points.reshape(-1, 3)).reshape(*points.shape[:2], 2).cpu().numpy()
    pose = camera.cam_from_world.to(points)
    ahead = ((points @ pose[2, :3] + pose[2, 3]) > camera.near).all(1).cpu().numpy()
    inside = (corners.max(1) > 0).all(1) & (corners.min(1) < (camera.width, camera.height)).all(1)
    for one in corners[ahead & inside]:
        cv2.polylines(picture, [cv2.convexHull(np.rint(one - 0.5).astype(np.int32))], True, OUTLINE, 1, cv2.LINE_AA)


def photo_beside(shown: np.ndarray, photo: np.ndarray, K: np.ndarray, camera: Camera, share: float) -> np.ndarray:
    """``shown`` with its left ``share`` replaced by ``photo`` [h, w, 3], taken from the same pose through the lens ``K``.

    The photo is scaled and shifted to the lens of ``camera``; pixels that it does not cover are unchanged.
    """
    lens = camera.K.cpu().numpy()
    scale = lens[0, 0] / K[0, 0], lens[1, 1] / K[1, 1]
    shift = lens[0, 2] - scale[0] * K[0, 2], lens[1, 2] - scale[1] * K[1, 2]
    # Pixel centres are at +0.5 here and at integers in OpenCV.
    moved = np.array([[scale[0], 0, shift[0] + 0.5 * scale[0] - 0.5], [0, scale[1], shift[1] + 0.5 * scale[1] - 0.5]])
    size = (camera.width, camera.height)
    there = cv2.warpAffine(np.full(photo.shape[:2], 255, np.uint8), moved, size, flags=cv2.INTER_NEAREST) > 0
    there[:, round(share * camera.width) :] = False
    result = shown.copy()
    result[there] = cv2.warpAffine(photo, moved, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)[there]
    edge = round(share * camera.width)
    if 0 < edge < camera.width:
        result[:, edge - 1 : edge + 1] = 255
    return result
