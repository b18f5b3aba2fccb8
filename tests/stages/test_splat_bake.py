"""Gaussians fitted to convexes render nearer to them, before cameras that the fit has not seen, than the best uniform ones."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from e4dgs.rasterizer import Gaussians
from e4dgs.scene.convex_gaussians import GaussianFit
from e4dgs.scene.fibonacci import fibonacci_sphere
from e4dgs.scene.model import Model
from e4dgs.scene.primitives import ConvexSet, GaussianSet
from e4dgs.stages.artifacts.frameset import FrameSet
from e4dgs.stages.exports.bake import SPREADS, Baked, bake, loss_of
from e4dgs.stages.exports.plain import PlainLook
from run_stage import run_frames


@pytest.fixture(scope="module")
def frames(dnerf_capture, tmp_path_factory) -> FrameSet:
    return FrameSet(run_frames(dnerf_capture.root, tmp_path_factory.mktemp("bake")).artifact, dnerf_capture.root)


def made_of_convexes() -> Model:
    """Forty uneven convexes before a few Gaussians."""
    rng = np.random.default_rng(4)
    centres, colors = rng.uniform(-0.8, 0.8, (40, 1, 3)) + np.array([0, 0, 0.4]), rng.uniform(0, 1, (40, 3))
    points = centres + 0.3 * fibonacci_sphere(6) * rng.uniform(0.3, 1.2, (40, 6, 1))
    gaussians = GaussianSet.from_points(centres[:10, 0].astype(np.float32), colors[:10], 1)
    return Model(gaussians, ConvexSet.from_points(points.astype(np.float32), colors, 1, opacity=0.8), None, 1, background=(1.0, 1.0, 1.0))


@pytest.fixture(scope="module")
def fitted(frames) -> Gaussians:
    return bake(made_of_convexes(), frames).at(0.0)


def test_the_fit_is_nearer_than_uniform_gaussians_from_cameras_it_has_not_seen(frames, fitted):
    model = made_of_convexes()
    loss = loss_of(model, fitted, frames, 0.0)
    uniform = [
        loss_of(model, Baked(model, GaussianFit.uniform(model.convexes.points.detach(), s), PlainLook.unchanged(10)).at(0.0), frames, 0.0)
        for s in SPREADS
    ]
    assert (loss.cameras, loss.convexes) == (4, 40)
    assert loss.psnr > max(one.psnr for one in uniform) + 0.7
    assert "40 convexes became Gaussians" in str(loss)


@pytest.mark.parametrize(("size", "by_opacity", "by_scale"), [(0.01, 15, -1), (0.04, 3, 8)])
def test_an_antialiased_model_loses_less_when_it_is_adjusted_for_other_programs(frames, size, by_opacity, by_scale):
    """Programs without the antialiased mode draw Gaussians too large. For small ones opacities make up for it, for large ones scales."""
    rng = np.random.default_rng(6)
    gaussians = GaussianSet.from_points(rng.uniform(-0.8, 0.8, (3000, 3)), rng.uniform(0, 1, (3000, 3)), 1, opacity=0.6, max_scale=size)
    model = Model(gaussians, ConvexSet.empty(6, 1), None, 1, background=(1.0, 1.0, 1.0), antialiased=True)
    adjusted = bake(model, frames)
    as_it_is = replace(adjusted, plain=PlainLook.unchanged(3000))
    opacities_alone = replace(adjusted, plain=replace(adjusted.plain, excess=torch.zeros(3000)))
    full, some, none = (loss_of(model, one.at(0.0), frames, 0.0).psnr for one in (adjusted, opacities_alone, as_it_is))
    assert full > 30 and some > none + by_opacity and full > some + by_scale, (full, some, none)


def test_the_same_model_gives_the_same_gaussians(frames, fitted):
    again = bake(made_of_convexes(), frames).at(0.0)
    assert torch.equal(again.means, fitted.means) and torch.equal(again.scales, fitted.scales)


def test_without_convexes_nothing_is_lost(frames):
    model = made_of_convexes()
    bare = Model(model.gaussians, model.convexes.select(torch.arange(0)), None, 1)
    loss = loss_of(bare, bake(bare, frames).at(0.0), frames, 0.0)
    assert loss.psnr > 90 and "convexes" not in str(loss)
