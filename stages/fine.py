"""`fine`: convexes join the Gaussians where edges are dense, and both are refined."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import Field

from ..pipeline import Applies, Context, Resources, Stage
from ..scene.settings import TrainingSettings


class FineSettings(TrainingSettings):
    iterations: int = Field(1500, ge=0, le=1_000_000, description="optimiser steps of this stage")
    lr_scale: float = Field(0.3, gt=0, le=1, description="factor on the first rates of what `coarse` has already trained")
    convex_opacity: float = Field(0.3, gt=0, lt=1, description="opacity with which convexes begin")


class Fine(Stage):
    """Refines the model of `coarse` together with the convexes of `hulls`."""

    name = "fine"
    inputs = ("frames", "poses", "flow", "hulls", "coarse")
    settings = FineSettings
    reads_capture = True
    device_class = True

    def applies(self, facts: Mapping[str, Any], settings: FineSettings) -> Applies:
        if settings.iterations == 0:
            return Applies.no("fine.iterations is 0")
        return Applies.yes("Gaussians and convexes together")

    def estimate(self, facts: Mapping[str, Any], settings: FineSettings) -> float | None:
        from .estimates import training_seconds

        return training_seconds(facts, settings.iterations, static=bool(facts.get("static")))

    def resources(self, facts: Mapping[str, Any], settings: FineSettings, device: str) -> Resources:
        from .estimates import training_resources

        return training_resources(facts, device)

    def run(self, ctx: Context) -> None:
        import torch

        from ..scene.primitives import LIFE, ConvexSet
        from ..scene.training.recipe import RECIPES
        from ..scene.training.schedule import fine_phases
        from ..scene.training.trainer import Trainer
        from .artifacts.dataset import load_frameset, load_views, measured_flow
        from .artifacts.training import read_depth, read_model, required, write_training
        from .coarse import auto_budget, is_static
        from .seeding.fill import measured_depth

        settings = ctx.settings
        torch.manual_seed(settings.seed)
        coarse, hulls = required(ctx.inputs["coarse"]), ctx.inputs["hulls"]
        model = read_model(coarse)
        frames = load_frameset(ctx.inputs, ctx.capture.root)
        views = load_views(frames, ctx.inputs["flow"], ctx.device, model)
        if hulls is not None and hulls.array("points").shape[0]:
            model.convexes = ConvexSet.from_hulls(hulls.read("points"), hulls.read("colors"), model.sh_degree, settings.convex_opacity)
            seeds = torch.from_numpy(hulls.read("seed")).long()
            for name in ("hyper", *LIFE):
                model.convexes.parameters[name].data.copy_(model.gaussians.parameters[name][seeds])
            model.convexes.dynamic = model.gaussians.dynamic[seeds]
        else:
            ctx.log("no convexes: no seed lies on enough edges; Gaussians alone are refined")
        model.to(ctx.device)

        strategy = coarse.attrs["strategy"]
        kind = "planes" if model.field is None else str(model.field.config["kind"])
        unit = views.viewing_distance(model.gaussians.means.detach().cpu().numpy())
        depth = measured_depth(read_depth(coarse), unit, ctx, frames)
        phases = fine_phases(strategy, coarse.attrs["iterations"], settings.iterations, is_static(ctx))
        with ctx.progress(sum(phase.iterations for phase in phases), "fine") as bar:
            trainer = Trainer(
                model,
                views,
                phases,
                settings,
                budget=settings.budget or auto_budget(ctx.facts, views, kind == "nodes"),
                checkpoints=ctx.checkpoints,
                lr_scale=1.0 if strategy == "joint" else settings.lr_scale,
                grow=strategy == "joint",
                measured_flow=measured_flow(ctx.inputs["flow"], views),
                measured_depth=depth,
                recipe=RECIPES[kind],
                advance=lambda n, note: bar.advance(n, note),
                log=ctx.log,
            )
            log = trainer.run()
        write_training(ctx.out, model, log)
