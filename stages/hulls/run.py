"""The work of `hulls`: chooses the Gaussians that become convexes."""

from __future__ import annotations

import numpy as np
import torch

from ...pipeline import Context
from ...pipeline.choice.evenly import evenly
from ...scene.primitives import SH_C0, ConvexSet
from ..coarse.artifact import required
from ..shared.dataset import load_frameset, load_views
from ..shared.model import read_model
from .artifact import StoredHulls
from .defaults import VIEWS, most_convexes
from .edge_seeds import EdgeSeeds, edge_seeds
from .settings import HullSettings

LEAST_WEIGHT = 1.0  # px over all views: what is hardly seen says nothing


def place_convexes(ctx: Context) -> None:
    """Attributes edges, and the error there, to the Gaussians of `coarse`. Those with the most error become convexes."""
    settings = ctx.settings
    model = read_model(required(ctx.inputs["coarse"])).to(ctx.device)
    most = most_convexes(settings.budget, model.motion.kind)
    none = np.zeros(0)
    found, reason = (
        EdgeSeeds(none, none, none),
        "control nodes move the scene, with which convexes gain nothing; hulls.budget sets a number",
    )
    if most:
        views = load_views(load_frameset(ctx.inputs, ctx.capture.root), ctx.inputs["flow"], ctx.device, model)
        frames = evenly(views.train, VIEWS)
        found = edge_seeds(model, views, [int(i) for i in frames])
    chosen = choose(found, settings, most)
    if most:
        reason = f"{len(chosen)} of {len(found.error)} Gaussians lie on badly shown edges and become convexes"
    ctx.log(reason)

    convexes = ConvexSet.replacing(model.gaussians.select(torch.from_numpy(chosen).to(ctx.device)), settings.k)
    colors = convexes.sh_dc.detach().cpu().numpy()[:, 0] * SH_C0 + 0.5
    StoredHulls(
        points=convexes.points.detach().cpu().numpy(),
        colors=colors.clip(0, 1).astype(np.float32),
        seed=chosen.astype(np.int32),
        edge_density=found.density[chosen].astype(np.float32),
        k=settings.k,
        reason=reason,
    ).write(ctx.out)


def choose(found: EdgeSeeds, settings: HullSettings, most: int) -> np.ndarray:
    """Sorted rows of the Gaussians that become convexes, at most ``most``."""
    most = min(most, int(settings.share * len(found.error)))
    eligible = np.flatnonzero((found.density >= settings.min_edge_density) & (found.weight > LEAST_WEIGHT) & (found.error > 0))
    return np.sort(eligible[np.argsort(-found.error[eligible], kind="stable")][:most])
