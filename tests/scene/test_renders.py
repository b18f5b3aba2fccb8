"""Renders of a model replayed for other cameras, times and backgrounds: with something on the CPU that computes again what was captured,
and as CUDA graphs."""

import warnings
from dataclasses import replace

import pytest
import torch
from e4dgs.rasterizer.cuda import capacity
from e4dgs.rasterizer.uniform import FAR_CAMERA
from e4dgs.scene.cuda import renders
from e4dgs.scene.cuda.renders import Renders
from replaying import KINDS, Again, begun


@pytest.fixture
def again(monkeypatch):
    monkeypatch.setattr(renders, "Graph", Again)


def replaying(what, device="cpu"):
    """A model, its views, and a function that renders it as on a GPU."""
    trainer = begun(what, device)
    model, views = trainer.model, trainer.views
    model._renders._usable = True

    def render(i, t, background=None, size=1.0):
        camera = views.rasterizer_camera(i, size)
        with torch.no_grad():
            background = torch.zeros(3) if background is None else torch.tensor(background)
            return model._renders(model._draw, model._memory(), model.device, camera, t, background), camera, background

    return model, views, render


def agrees(model, render, *given):
    got, camera, background = render(*given)
    with torch.no_grad():
        want = model._draw(camera, given[1], background)
    for name in ("color", "alpha", "depth"):
        assert (getattr(got, name) - getattr(want, name)).abs().max() < 1e-5, name
    assert torch.equal(got.visible_gaussians, want.visible_gaussians)
    return got


@pytest.mark.parametrize("what", KINDS)
def test_every_camera_time_and_background_gives_the_usual_render(what, again):
    model, views, render = replaying(what)
    first = agrees(model, render, 0, 0.5)
    color = first.color.clone()
    for i, t, background in ((0, 0.5, None), (3, 0.0, (1.0, 0.5, 0.0)), (7, 1.0, None), (2, 0.25, (0.0, 0.0, 1.0))):
        agrees(model, render, i, t, background)
    agrees(model, render, 0, 0.5, None, 0.5)
    assert torch.equal(first.color, color), "a frame stays as it is when others are rendered"
    assert len(model._renders._known) == 2
    with torch.no_grad():
        model.gaussians.means.add_(0.1)
    agrees(model, render, 1, 0.5)
    graph = model._renders._known[views.width, views.height, views.near]
    model.gaussians = model.gaussians.select(torch.arange(20))
    for _ in range(3):
        agrees(model, render, 1, 0.5)
    assert model._renders._known[views.width, views.height, views.near] is not graph, "another set is captured again"


def test_far_cameras_and_broken_ones_are_not_replayed(again):
    model, views, render = replaying("nodes")
    camera = views.rasterizer_camera(0)
    pose = camera.cam_from_world.clone()
    pose[2, 3] = FAR_CAMERA
    draw = model._draw, model._memory(), model.device
    for _ in range(3):
        model._renders(*draw, replace(camera, cam_from_world=pose), 0.5, torch.zeros(3))
    assert not model._renders._known
    for _ in range(2):
        agrees(model, render, 0, 0.5)
    with pytest.raises(ValueError, match="finite"):
        model._renders(*draw, replace(camera, cam_from_world=pose * torch.nan), 0.5, torch.zeros(3))
    with pytest.raises(ValueError, match="background must be finite"):
        model._renders(*draw, camera, 0.5, torch.full((3,), torch.nan))


def test_what_cannot_be_captured_is_drawn_as_usual_and_said_once(monkeypatch):
    def refuses(*given):
        raise RuntimeError("operation not permitted when stream is capturing")

    monkeypatch.setattr(renders, "Graph", refuses)
    model, _, render = replaying("lifetimes")
    agrees(model, render, 0, 0.5)
    with pytest.warns(UserWarning, match="not replayed as CUDA graphs: operation not permitted"):
        agrees(model, render, 0, 0.5)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        agrees(model, render, 0, 0.5)


def test_only_some_sizes_are_kept(again):
    model, _, render = replaying("lifetimes")
    for size in (1.0, 0.9, 0.8, 0.7, 0.6):
        for _ in range(2):
            agrees(model, render, 0, 0.5, None, size)
    assert len(model._renders._known) == renders.MOST_SIZES


def test_a_model_on_the_cpu_is_drawn_as_it_was(again):
    model, views, _ = replaying("lifetimes")
    for _ in range(3):
        model.render(views.rasterizer_camera(0), 0.5)
    assert not model._renders._known and isinstance(model._renders, Renders)


@pytest.mark.cuda
@pytest.mark.parametrize("what", KINDS)
def test_graphs_give_the_usual_render(what, monkeypatch):
    model, views, _ = replaying(what, "cuda")
    cameras = [views.rasterizer_camera(i) for i in range(8)]

    def both(i, t, background=None):
        with torch.no_grad(), warnings.catch_warnings():
            warnings.simplefilter("error")
            want = model._draw(cameras[i], t, torch.zeros(3) if background is None else background)
            got = model.render(cameras[i], t, torch.zeros(3) if background is None else background)
        assert (got.color - want.color).abs().max() < 1e-5 and (got.depth - want.depth).abs().max() < 1e-4

    for i in range(8):
        both(i, i / 7, torch.tensor([0.1 * i, 0.0, 1.0]))
    (known,) = model._renders._known.values()
    assert known is not None
    monkeypatch.setattr(capacity, "GRAPH_ROOM", 10)
    monkeypatch.setattr(capacity, "GRAPH_SPARE", 0.0)
    model._renders._known.clear()
    for i in range(8):  # far too little room: each frame is drawn as usual instead
        both(i, 0.5)
