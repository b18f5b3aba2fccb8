"""`fine`: convexes join the Gaussians where edges are dense, and both are refined."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import Field

from ..pipeline import Applies, Context, Resources, Stage
from ..scene.settings import TrainingSettings
from .captures.facts import Facts
from .estimates import training_resources, training_seconds


class FineSettings(TrainingSettings):
    iterations: int = Field(1500, ge=0, le=1_000_000, description="optimiser steps of this stage")
    lr_scale: float = Field(0.3, gt=0, le=1, description="factor on the first rates of what `coarse` has already trained")
    convex_opacity: float = Field(0.3, gt=0, lt=1, description="opacity with which convexes begin")


class Fine(Stage):
    """Refines the model of `coarse` together with the convexes of `hulls`."""

    name = "fine"
    version = 15  # 15: nodes are held steadier and their network's units cannot die; numbers below the normal ones are zero
    inputs = ("frames", "poses", "flow", "hulls", "coarse")
    settings = FineSettings
    reads_capture = True
    device_class = True

    def applies(self, facts: Mapping[str, Any], settings: FineSettings) -> Applies:
        if settings.iterations == 0:
            return Applies.no("fine.iterations is 0")
        return Applies.yes("Gaussians and convexes together")

    def estimate(self, facts: Mapping[str, Any], settings: FineSettings) -> float | None:
        known = Facts.of(facts)
        return training_seconds(known, settings.iterations, known.static)

    def resources(self, facts: Mapping[str, Any], settings: FineSettings, device: str) -> Resources:
        return training_resources(Facts.of(facts), device)

    def run(self, ctx: Context) -> None:
        import torch

        from ..scene.primitives import LIFE, ConvexSet
        from ..scene.training.recipe import RECIPES
        from ..scene.training.schedule import fine_phases
        from ..scene.training.trainer import Trainer
        from .artifacts.coarse import StoredCoarse, required
        from .artifacts.dataset import load_frameset, load_views, measured_flow
        from .artifacts.hulls import StoredHulls
        from .artifacts.model import read_model, write_model
        from .coarse import auto_budget, is_static
        from .seeding.fill import measured_depth

        settings = ctx.settings
        torch.manual_seed(settings.seed)
        artifact = required(ctx.inputs["coarse"])
        coarse, model = StoredCoarse.read(artifact), read_model(artifact)
        hulls = None if ctx.inputs["hulls"] is None else StoredHulls.read(ctx.inputs["hulls"])
        frames = load_frameset(ctx.inputs, ctx.capture.root)
        views = load_views(frames, ctx.inputs["flow"], ctx.device, model)
        if hulls is not None and len(hulls):
            model.convexes = ConvexSet.from_hulls(hulls.points, hulls.colors, model.sh_degree, settings.convex_opacity)
            seeds = torch.from_numpy(hulls.seed).long()
            for name in ("hyper", *LIFE):
                model.convexes.parameters[name].data.copy_(model.gaussians.parameters[name][seeds])
            model.convexes.dynamic = model.gaussians.dynamic[seeds]
        else:
            ctx.log("no convexes: no seed lies on enough edges; Gaussians alone are refined")
        model.to(ctx.device)

        kind = "planes" if model.field is None else str(model.field.config["kind"])
        unit = views.viewing_distance(model.gaussians.means.detach().cpu().numpy())
        depth = measured_depth(coarse.depth, unit, ctx, frames)
        phases = fine_phases(coarse.strategy, coarse.iterations, settings.iterations, is_static(ctx))
        with ctx.progress(sum(phase.iterations for phase in phases), "fine") as bar:
            trainer = Trainer(
                model,
                views,
                phases,
                settings,
                budget=settings.budget or auto_budget(Facts.of(ctx.facts), views, kind == "nodes"),
                checkpoints=ctx.checkpoints,
                lr_scale=1.0 if coarse.strategy == "joint" else settings.lr_scale,
                grow=coarse.strategy == "joint",
                measured_flow=measured_flow(ctx.inputs["flow"], views),
                measured_depth=depth,
                recipe=RECIPES[kind],
                advance=lambda n, note: bar.advance(n, note),
                log=ctx.log,
            )
            log = trainer.run()
        write_model(ctx.out, model, log)
