"""The work of `hulls`: places convexes at the Gaussians under which edges are dense."""

from __future__ import annotations

import numpy as np

from ...pipeline import Context
from ...scene.edge_seeds import edge_density
from ...scene.fibonacci import fibonacci_convexes, neighbour_radius
from ...scene.primitives import SH_C0
from ..artifacts.coarse import required
from ..artifacts.dataset import load_frameset, load_views
from ..artifacts.hulls import StoredHulls
from ..artifacts.model import read_model


def place_convexes(ctx: Context) -> None:
    """Attributes edge density to the Gaussians of `coarse` that are blended at edge pixels. Those with the most become seeds."""
    settings = ctx.settings
    model = read_model(required(ctx.inputs["coarse"])).to(ctx.device)
    views = load_views(load_frameset(ctx.inputs, ctx.capture.root), ctx.inputs["flow"], ctx.device, model)
    chosen = views.train[np.linspace(0, len(views.train) - 1, min(settings.views, len(views.train))).round().astype(int)]
    density, weight = edge_density(model, views, [int(i) for i in chosen])

    eligible = np.flatnonzero((density >= settings.min_edge_density) & (weight > 1.0))
    order = eligible[np.argsort(-(density * np.sqrt(weight))[eligible], kind="stable")][: settings.budget]
    order = np.sort(order)
    centres = model.gaussians.means.detach().cpu().numpy()[order].astype(np.float64)
    limit = 0.05 * views.viewing_distance(centres) if len(centres) else 1.0
    radii = np.minimum(neighbour_radius(centres) * settings.radius, limit)
    colors = model.gaussians.sh_dc.detach().cpu().numpy()[order, 0] * SH_C0 + 0.5

    reason = f"{len(order)} of {len(density)} Gaussians lie on edges (mean edge weight >= {settings.min_edge_density})"
    ctx.log(reason)
    StoredHulls(
        points=fibonacci_convexes(centres, radii, settings.k).astype(np.float32),
        colors=colors.clip(0, 1).astype(np.float32),
        seed=order.astype(np.int32),
        edge_density=density[order].astype(np.float32),
        k=settings.k,
        reason=reason,
    ).write(ctx.out)
