"""Light that changes over time: courses of light that the whole scene shares, and how far each primitive follows them."""

import numpy as np
import pytest
import torch
from e4dgs.rasterizer import Camera
from e4dgs.scene.model import Model
from e4dgs.scene.motion.nodes.control_nodes import ControlNodes
from e4dgs.scene.motion.nodes.light import SHADES
from e4dgs.scene.motion.nodes.schedule import NODES
from e4dgs.scene.motion.phases import Phase
from e4dgs.scene.motion.static import Static
from e4dgs.scene.primitives import SH_C0, ConvexSet, GaussianSet
from e4dgs.scene.training.trainer import Trainer
from sliding_gaussians import SETTINGS, wandering_views

TIMES = (0.0, 0.3, 1.0)


def lit(shades=0.5):
    """Twenty Gaussians and a convex on control nodes that do not move. Each follows the light by ``shades`` times a random amount."""
    rng = np.random.default_rng(4)
    points = rng.uniform(-1, 1, (20, 3))
    gaussians = GaussianSet.from_points(points, rng.uniform(0.2, 0.8, (20, 3)), 1, opacity=0.9)
    convexes = ConvexSet.from_points(rng.normal(size=(1, 6, 3)) * 0.3, np.full((1, 3), 0.4), 1)
    generator = torch.Generator().manual_seed(1)
    with torch.no_grad():
        gaussians.sh_rest.normal_(0, 0.1, generator=generator)
        gaussians, convexes = (kind.carrying(ControlNodes.attributes) for kind in (gaussians, convexes))
        for kind in (gaussians, convexes):
            kind.shades.copy_(shades * torch.randn(len(kind), SHADES, generator=generator))
    nodes = ControlNodes(torch.tensor(points[:8]), torch.zeros(3), extent=1.0, reach=1.0)
    return Model(gaussians, convexes, nodes, 1)


def test_without_shades_colours_are_the_same_at_all_times_bit_for_bit():
    model = lit(shades=0.0)
    for t in TIMES:
        for primitives, own in zip(model.at(t), (model.gaussians, model.convexes)):
            assert torch.equal(primitives.sh, torch.cat([own.sh_dc, own.sh_rest], 1))


def test_light_multiplies_the_colour_that_all_directions_share():
    model = lit()
    for t in TIMES:
        light = model.motion.light(t)
        assert light.shape == (SHADES,)
        for primitives, own in zip(model.at(t), (model.gaussians, model.convexes)):
            factor = 1 + (own.shades * light).sum(1)
            before = 0.5 + SH_C0 * own.sh_dc[:, 0]
            assert torch.allclose(0.5 + SH_C0 * primitives.sh[:, 0], factor[:, None] * before, atol=1e-5)
            assert torch.equal(primitives.sh[:, 1:], own.sh_rest)
    assert (model.motion.light(0.0) - model.motion.light(0.3)).abs().max() > 0.01


def test_a_model_from_before_light_is_loaded_and_looks_the_same_at_all_times():
    model = lit(shades=0.0)
    older = {name: array for name, array in model.to_arrays().items() if not name.endswith("_shades") and "field_light." not in name}
    assert len(older) == len(model.to_arrays()) - 2 - len(list(model.motion.light.parameters()))
    loaded = Model.from_arrays(older, {name: value for name, value in model.config.items() if name != "antialiased"})
    assert not loaded.antialiased
    for t in TIMES:
        for now, before in zip(loaded.at(t), model.at(t)):
            assert torch.equal(now.sh, before.sh)


def test_the_rest_state_has_no_light():
    model = lit()
    own = model.gaussians
    assert torch.equal(model.at(0.5, move=False)[0].sh, torch.cat([own.sh_dc, own.sh_rest], 1))


@pytest.mark.parametrize("name", ["shades", "sh_dc"])
def test_gradients_of_colours_under_light_match_central_differences(name):
    gaussians, light = lit().gaussians, torch.linspace(-1, 1, SHADES)
    weights = torch.randn(20, 4, 3, generator=torch.Generator().manual_seed(2))
    value = gaussians.parameters[name]

    def total():
        return (gaussians.activated((gaussians.log_scales,), 1, light)[2] * weights).sum(dtype=torch.float64)

    gradient = torch.autograd.grad(total(), value)[0].flatten()
    step = 1e-2
    for k in range(0, value.numel(), 7):
        ends = []
        for side in (step, -step):
            with torch.no_grad():
                value.view(-1)[k] += side
                ends.append(float(total()))
                value.view(-1)[k] -= side
        assert float(gradient[k]) == pytest.approx((ends[0] - ends[1]) / (2 * step), rel=1e-2, abs=1e-3)


def test_times_outside_the_capture_have_the_light_of_its_ends():
    nodes = lit().motion
    assert torch.equal(nodes.light(-1.0), nodes.light(0.0)) and torch.equal(nodes.light(2.0), nodes.light(1.0))


def test_training_finds_a_light_that_rises():
    """Half of the picture brightens threefold over the capture, and nothing moves."""
    views = wandering_views(frames=26)
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.8, 0.8, (40, 3))
    colors = np.full((40, 3), 0.25)
    camera = Camera(torch.tensor(views.K[0]).float(), torch.tensor(views.cam_from_world[0]).float(), views.width, views.height)

    def at_rest():
        gaussians = GaussianSet.from_points(points, colors, 0, opacity=0.9, max_scale=0.2)
        nodes = ControlNodes(torch.tensor(points[::4]), torch.zeros(3), extent=1.0, reach=1.0)
        return Model(gaussians, ConvexSet.empty(6, 0), nodes, 0)

    def picture(t, view):
        model = at_rest()
        with torch.no_grad():
            model.gaussians.sh_dc[:20] = (0.25 * (1 + 2 * t) - 0.5) / SH_C0
        model.motion = Static()
        return model.render(view, t).color

    pictures = [picture(float(t), views.rasterizer_camera(i)) for i, t in enumerate(views.time)]
    views.load = lambda i: (pictures[i].clamp(0, 1) * 255).round().to(torch.uint8).numpy()
    model = at_rest()
    settings = SETTINGS.model_copy(update={"iterations": 400, "densify_until": 0.0, "min_contribution": 0.0})
    Trainer(model, views, [Phase("deformation", 400)], settings, 40, grow=False, recipe=NODES).run()
    errors = [float((model.render(camera, t).color - picture(t, camera)).square().mean()) for t in (0.0, 0.5, 1.0)]
    steady = [float((picture(0.5, camera) - picture(t, camera)).square().mean()) for t in (0.0, 1.0)]
    assert max(errors) < 0.1 * min(steady)
