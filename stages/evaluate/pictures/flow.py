"""The flow pictures of the report, as in Fig. 5 of the paper: a training frame, its measured flow, and the flow that the model renders."""

from __future__ import annotations

import numpy as np
import torch

from ....scene.losses.flow_loss import rendered_flow
from ....vision.flow.colours import colour_wheel, flow_colours, typical_largest
from ....vision.images.overlay import EDGE_COLOUR, MASK_STRENGTH, MOVING_COLOUR, overlay
from ...flow.artifact import StoredFlow
from ..judge import Judge
from ..spread import spread
from .book import PictureBook

MOST_PAIRS = 4
FLOW_SIZE = 480  # px, longest side of these pictures
WHEEL_SIZE = 128  # px
EDGE = 128  # of 255, least weight of an edge pixel
TRUSTED = 128  # of 255, least confidence of a pixel that counts in the difference
COVERED = 0.5  # pixels with more alpha count in the difference, as in the flow loss


def add_flow(book: PictureBook, judge: Judge, flow: StoredFlow, most: int) -> None:
    """Adds up to ``most`` pairs of frames, evenly spread over cameras and times, to the book as "flow/<k>/frame|measured|rendered|
    edges|moving" and "flow/wheel", and describes them in `book.stored`.

    All are coloured on the same scale, `largest`. Only pairs of training frames with poses are shown.
    """
    frames = judge.frames
    posed = {int(i) for i in frames.train}
    chosen = spread([p for p, pair in enumerate(flow.pairs) if posed.issuperset(pair)], min(most, MOST_PAIRS))
    if not chosen:
        return
    measured = {p: flow.forward(p).astype(np.float32) for p in chosen}
    largest = typical_largest(*measured.values())
    size = min(book.size, FLOW_SIZE)
    rows = []
    for k, p in enumerate(chosen):
        first, second = flow.pairs[p]
        rendered, alpha = _rendered(judge, first, second)
        picture = frames.composited(first)
        book.add(f"flow/{k}/frame", picture, size)
        book.add(f"flow/{k}/measured", flow_colours(measured[p], largest), size)
        # Flow fades as colour does where the background, which does not move, shows through.
        shown = rendered * np.minimum(alpha / COVERED, 1)[..., None]
        book.add(f"flow/{k}/rendered", flow_colours(shown, largest), size)
        book.add(f"flow/{k}/edges", overlay(picture, flow.edges(first), EDGE_COLOUR), size)
        moving = flow.moving_pixels(first, int(frames.camera[first]))
        if moving is not None:
            book.add(f"flow/{k}/moving", overlay(picture, moving, MOVING_COLOUR, MASK_STRENGTH), size)
        rows.append(
            {
                "stem": f"flow/{k}",
                "frames": [frames.names[first], frames.names[second]],
                "times": [float(frames.time[first]), float(frames.time[second])],
                **difference(measured[p], rendered, (flow.confidence(p) >= TRUSTED) & (alpha > COVERED), flow.edges(first) >= EDGE),
            }
        )
    book.add("flow/wheel", colour_wheel(WHEEL_SIZE), WHEEL_SIZE)
    book.stored.flow = {"largest": largest, "method": flow.method, "pairs": rows}


def difference(measured: np.ndarray, rendered: np.ndarray, counts: np.ndarray, edges: np.ndarray) -> dict[str, float | None]:
    """Over the pixels that count, in px: `difference`, the mean difference between the flows; `motion`, the mean measured length;
    `at_edges`, the median difference where ``edges``. None if no pixel counts.

    measured, rendered: float [H, W, 2] px. counts, edges: bool [H, W]; a pixel with a value that is not finite does not count.
    """
    counts = counts & np.isfinite(rendered).all(-1) & np.isfinite(measured).all(-1)
    wrong, length = (np.linalg.norm(field.astype(np.float64), axis=-1) for field in (measured - rendered, measured))
    values = {"difference": wrong[counts], "motion": length[counts], "at_edges": wrong[counts & edges]}
    mean = {name: float(np.median(chosen) if name == "at_edges" else chosen.mean()) for name, chosen in values.items() if chosen.size}
    return {name: round(mean[name], 4) if name in mean else None for name in values}


def _rendered(judge: Judge, first: int, second: int) -> tuple[np.ndarray, np.ndarray]:
    """The model's flow, float32 [H, W, 2] px, from frame ``first`` to ``second``, and alpha [H, W] of the first."""
    times = judge.frames.time
    with torch.no_grad():
        flow, alpha = rendered_flow(judge.model, judge.camera(first), float(times[first]), judge.camera(second), float(times[second]))
    return flow.cpu().numpy(), alpha.cpu().numpy()
