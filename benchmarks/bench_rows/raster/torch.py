"""Our rasterizer against a tile rasterizer in plain torch on the same scene, with the same rules of blending."""

from __future__ import annotations

import torch
from e4dgs.rasterizer.reference.compare import relative_l2
from e4dgs.workflows.bench.render import both, forward
from e4dgs.workflows.bench.rows import Bench, Check, Measured
from e4dgs.workflows.bench.scenes import garden
from e4dgs.workflows.bench.timing import interleaved, ratio

from ..peers.rasterizer import rasterize_torch

BAR = 50.0


def measure(bench: Bench) -> Measured:
    scene, name = garden(bench)
    image_of, peer_image_of = forward(scene), forward(scene, rasterize_torch)
    gradients_of, peer_gradients_of = both(scene), both(scene, rasterize_torch)
    times = interleaved(
        bench,
        {
            "ours, forward": image_of,
            "torch, forward": peer_image_of,
            "ours, forward + backward": gradients_of,
            "torch, forward + backward": peer_gradients_of,
        },
    )
    whole, note = ratio(times["torch, forward + backward"], times["ours, forward + backward"])
    alone, note_alone = ratio(times["torch, forward"], times["ours, forward"])
    difference = (image_of().color - peer_image_of().color).abs().amax(2)
    gradients = max(relative_l2(a, b) for a, b in zip(peer_gradients_of(), gradients_of()))
    checks = [
        Check("forward + backward, torch's time over ours", whole, BAR, "above", note=note),
        Check("forward, torch's time over ours", alone, note=note_alone),
        Check("mean difference of the images", float(difference.mean()), unit="", note="both draw the same scene"),
        Check("largest relative difference of a gradient", gradients, unit="", note="L2; a flip at a threshold counts"),
    ]
    return Measured(
        protocol=f"{name}; colour and gradients of all fields of the Gaussians; {torch.get_num_threads()} threads",
        checks=checks,
        numbers={"times": {what: timing.json() for what, timing in times.items()}, "largest_difference": float(difference.max())},
        columns=("", "best ms", "median ms", "runs"),
        table=[(what, f"{1e3 * t.best:.1f}", f"{1e3 * t.median:.1f}", str(len(t.runs))) for what, t in times.items()],
    )
