"""Gaussians fitted to convexes render nearer to them, before cameras that the fit has not seen, than the best uniform ones."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from e4dgs.pipeline import SettingsError
from e4dgs.rasterizer import Gaussians
from e4dgs.scene.convex_gaussians import GaussianFit
from e4dgs.scene.fibonacci import fibonacci_sphere
from e4dgs.scene.model import Model
from e4dgs.scene.motion.static import Static
from e4dgs.scene.primitives import ConvexSet, GaussianSet
from e4dgs.stages.exports.bake import SPREADS, Baked, bake, loss_of
from e4dgs.stages.exports.capture_cameras import camera_of
from e4dgs.stages.exports.plain import PlainLook, compensated
from e4dgs.stages.shared.posed_frameset import PosedFrameSet
from run_stage import run_frames


@pytest.fixture(scope="module")
def frames(dnerf_capture, tmp_path_factory) -> PosedFrameSet:
    return PosedFrameSet(run_frames(dnerf_capture.root, tmp_path_factory.mktemp("bake")).artifact, dnerf_capture.root)


def made_of_convexes() -> Model:
    """Forty uneven convexes before a few Gaussians."""
    rng = np.random.default_rng(4)
    centres, colors = rng.uniform(-0.8, 0.8, (40, 1, 3)) + np.array([0, 0, 0.4]), rng.uniform(0, 1, (40, 3))
    points = centres + 0.3 * fibonacci_sphere(6) * rng.uniform(0.3, 1.2, (40, 6, 1))
    gaussians = GaussianSet.from_points(centres[:10, 0].astype(np.float32), colors[:10], 1)
    return Model(
        gaussians, ConvexSet.from_points(points.astype(np.float32), colors, 1, opacity=0.8), Static(), 1, background=(1.0, 1.0, 1.0)
    )


@pytest.fixture(scope="module")
def fitted(frames) -> Baked:
    return bake(made_of_convexes(), frames)


def test_the_fit_is_nearer_than_uniform_gaussians_from_cameras_it_has_not_seen(frames, fitted):
    model = made_of_convexes()
    loss, plain = loss_of(fitted, frames, 0.0), PlainLook.unchanged(10)
    uniform = [loss_of(Baked(model, GaussianFit.uniform(model.convexes.points.detach(), spread), plain), frames, 0.0) for spread in SPREADS]
    assert (loss.cameras, loss.convexes) == (4, 40)
    assert loss.psnr > max(one.psnr for one in uniform) + 0.7
    assert "40 convexes became Gaussians" in str(loss)


@pytest.mark.parametrize(("size", "by_opacity", "by_scale"), [(0.01, 15, -1), (0.04, 3, 8)])
def test_an_antialiased_model_loses_less_when_it_is_adjusted_for_other_programs(frames, size, by_opacity, by_scale):
    """Programs without the antialiased mode draw Gaussians too large. For small ones opacities make up for it, for large ones scales."""
    model = antialiased(size)
    adjusted = bake(model, frames)
    as_it_is = replace(adjusted, plain=PlainLook.unchanged(3000))
    opacities_alone = replace(adjusted, plain=replace(adjusted.plain, excess=torch.zeros(3000)))
    full, some, none = (loss_of(one, frames, 0.0).psnr for one in (adjusted, opacities_alone, as_it_is))
    assert full > 30 and some > none + by_opacity and full > some + by_scale, (full, some, none)


def antialiased(size: float, convexes: bool = False) -> Model:
    rng = np.random.default_rng(6)
    gaussians = GaussianSet.from_points(rng.uniform(-0.8, 0.8, (3000, 3)), rng.uniform(0, 1, (3000, 3)), 1, opacity=0.6, max_scale=size)
    other = made_of_convexes().convexes if convexes else ConvexSet.empty(6, 1)
    return Model(gaussians, other, Static(), 1, background=(1.0, 1.0, 1.0), antialiased=True)


def test_for_antialiased_viewers_gaussians_stay_as_they_were_trained(frames):
    model = antialiased(0.02, convexes=True)
    baked, classic = bake(model, frames, antialiased=True), bake(model, frames)
    own = model.at(0.0)[0]
    for name in ("means", "quats", "scales", "opacities", "sh"):
        assert torch.equal(getattr(baked.at(0.0), name)[:3000], getattr(own, name)), name
    assert len(baked.at(0.0).means) == 3040, "convexes are Gaussians, too"
    right = loss_of(baked, frames, 0.0)
    wrong = loss_of(replace(classic, antialiased=True), frames, 0.0), loss_of(replace(baked, antialiased=False), frames, 0.0)
    assert all(right.psnr > one.psnr + 2 for one in wrong), (right, wrong)
    assert "antialiased (compensated opacity) viewers" in str(right) and "classic (0.3 px² added) viewers" in str(wrong[1])


def test_what_such_viewers_compensate_is_gsplat_s_formula(frames):
    """sqrt(det S / det(S + 0.3 I)) for a ball of radius s straight ahead: S = (f s / z)^2 I."""
    model = antialiased(0.02)
    camera = camera_of(model, frames, int(frames.train[0]))
    ball = replace(model.at(0.0)[0], scales=torch.full((3000, 3), 0.01), opacities=torch.full((3000,), 0.5))
    inverse = torch.linalg.inv(camera.cam_from_world)
    ball.means = (inverse @ torch.tensor([0.0, 0, 2, 1]))[:3].expand(3000, 3)
    variance = float(camera.K[0, 0] * 0.01 / 2) ** 2
    torch.testing.assert_close(
        compensated(camera, ball).opacities, torch.full((3000,), 0.5 * variance / (variance + 0.3)), rtol=1e-3, atol=0
    )


def test_a_model_for_the_default_mode_has_nothing_for_antialiased_viewers(frames):
    with pytest.raises(SettingsError, match=r"coarse\.antialiased=false"):
        bake(made_of_convexes(), frames, antialiased=True)


def test_the_same_model_gives_the_same_gaussians(frames, fitted):
    again, before = bake(made_of_convexes(), frames).at(0.0), fitted.at(0.0)
    assert torch.equal(again.means, before.means) and torch.equal(again.scales, before.scales)


def test_without_convexes_nothing_is_lost(frames):
    model = made_of_convexes()
    bare = Model(model.gaussians, model.convexes.select(torch.arange(0)), Static(), 1)
    loss = loss_of(bake(bare, frames), frames, 0.0)
    assert loss.psnr > 90 and "convexes" not in str(loss)


class Fading(Baked):
    """Right at first, and then ever more transparent."""

    def at(self, t: float) -> Gaussians:
        made = super().at(t)
        return replace(made, opacities=(1 - t) * made.opacities)


def test_a_loss_that_grows_in_the_clip_is_said(frames):
    model = made_of_convexes()
    bare = Model(model.gaussians, model.convexes.select(torch.arange(0)), Static(), 1)
    fading = Fading(bare, GaussianFit.uniform(bare.convexes.points.detach(), 1.0), PlainLook.unchanged(10))
    one, last, all_of = (loss_of(fading, frames, *moments) for moments in ([0.0], [1.0], np.linspace(0, 1, 60)))
    assert one.psnr > 90 and "worst" not in str(one) and all_of.times == 5
    assert (all_of.worst, all_of.when) == (last.psnr, 1.0) and last.psnr < all_of.psnr < last.psnr + 10 * np.log10(5)
    assert f"4 cameras at 5 times, the worst {last.psnr:.1f} dB at time 1" in str(all_of)
