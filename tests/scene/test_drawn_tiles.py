"""Which tiles a step draws: all that move, a share of those that never change, and in expectation everything."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from e4dgs.rasterizer import TILE
from e4dgs.scene.losses.appearance import appearance_loss
from e4dgs.scene.settings import TrainingSettings
from e4dgs.scene.training.drawn_tiles import LEAST_SHARE, LEAST_TIMES, MOST_DRAWN, STATIC_STEPS, DrawnTiles
from e4dgs.scene.views import Views

WIDTH, HEIGHT, CAMERAS = 200, 120, 2
LONG = round(STATIC_STEPS / LEAST_SHARE)  # steps of a training with the smallest share
SHARE = LEAST_SHARE
ROWS, COLUMNS = -(-HEIGHT // TILE), -(-WIDTH // TILE)


def rig(times=LEAST_TIMES, moving=lambda i: square(i), cameras=CAMERAS):
    """Frames of a rig, camera by camera; ``moving(i)`` [H, W] uint8 marks what moves in frame i."""
    n = times * cameras
    camera = np.repeat(np.arange(cameras), times)
    K = np.repeat(np.diag([WIDTH, WIDTH, 1.0])[None], n, 0)
    views = Views(
        K,
        np.repeat(np.eye(4)[None], n, 0),
        np.tile(np.linspace(0, 1, times), cameras),
        camera,
        np.full(n, -1),
        np.arange(n),
        WIDTH,
        HEIGHT,
        None,
    )
    views.load_moving = moving
    return views


def square(i):
    """A 20 px square that moves 2 px a frame."""
    mask = np.zeros((HEIGHT, WIDTH), np.uint8)
    mask[40:60, 30 + 2 * i : 50 + 2 * i] = 255
    return mask


@pytest.mark.parametrize("scale", [1.0, 0.5])
def test_what_moves_is_always_drawn_and_the_rest_in_its_share_of_the_steps(scale):
    tiles = DrawnTiles(rig(), seed=0, steps=LONG)
    moving, steps = tiles.moving(3, scale), 4000
    drawn = [tiles.of(3, scale, step).tiles.numpy() for step in range(steps)]
    mean = np.mean(drawn, 0)
    assert moving.any() and (mean[moving] == 1).all()
    assert np.abs(mean[~moving] - SHARE).max() < 4 * np.sqrt(SHARE * (1 - SHARE) / steps)


def test_the_weight_is_0_or_what_makes_up_for_the_steps_that_leave_a_pixel_out():
    tiles, steps = DrawnTiles(rig(), seed=0, steps=LONG), 4000
    some = [tiles.of(3, 1.0, step) for step in range(steps)]
    for one in some[:50]:
        pixels = one.tiles.repeat_interleave(TILE, 0).repeat_interleave(TILE, 1)[:HEIGHT, :WIDTH]
        weight = one.pixels(torch.zeros(HEIGHT, WIDTH, 3))
        assert one.weight.shape == (ROWS, COLUMNS) and weight.shape == (HEIGHT, WIDTH) and torch.equal(weight > 0, pixels)
    mean = torch.stack([one.pixels(torch.zeros(HEIGHT, WIDTH)) for one in some]).mean(0)
    assert float((mean - 1).abs().max()) < 4 * np.sqrt((1 - SHARE) / SHARE / steps)


@pytest.mark.parametrize("masked", [False, True])
def test_alpha_is_weighted_like_colours(masked):
    """Its loss leaves out what is not drawn, and its gradient makes up for that."""
    draw = torch.Generator().manual_seed(0)
    color, target, known = torch.rand(6, 5, 3, generator=draw), torch.rand(6, 5, 3, generator=draw), torch.rand(6, 5, generator=draw)
    alpha, weight = torch.rand(6, 5, generator=draw).requires_grad_(), torch.full((6, 5), 4.0)
    weight[:3] = 0
    kept = torch.rand(6, 5, generator=draw) < 0.5 if masked else None
    counts = weight != 0 if kept is None else (weight != 0) & kept
    settings = TrainingSettings(l1_weight=0.0, ssim_weight=0.0, alpha_weight=2.0)
    frame = SimpleNamespace(color=color, alpha=alpha)
    rendered = SimpleNamespace(frame=frame, target=target, kept=kept, weight=weight, recording=None, share=1.0)
    loss = appearance_loss(rendered, settings, (0.0, 0.0, 0.0), known)
    wrong = (alpha - known).detach()
    assert float(loss) == pytest.approx(2 * float((wrong.abs() * counts).mean()))
    loss.backward()
    assert torch.allclose(alpha.grad, 2 / 30 * weight * counts * wrong.sign())


def test_a_tile_of_which_a_single_pixel_moves_is_drawn():
    mask = np.zeros((HEIGHT, WIDTH), np.uint8)
    mask[TILE, 3 * TILE] = 255
    moving = DrawnTiles(rig(moving=lambda i: mask), seed=0, steps=LONG).moving(0, 1.0)
    assert moving[1, 3] and moving.sum() == 1
    assert DrawnTiles(rig(moving=lambda i: mask), seed=0, steps=LONG).moving(0, 0.5)[0, 1]


def test_the_choice_depends_on_seed_and_step_alone():
    first, again, other = (
        DrawnTiles(rig(), seed=0, steps=LONG),
        DrawnTiles(rig(), seed=0, steps=LONG),
        DrawnTiles(rig(), seed=1, steps=LONG),
    )
    assert torch.equal(first.of(1, 1.0, 7).tiles, again.of(1, 1.0, 7).tiles)
    assert not torch.equal(first.of(1, 1.0, 7).tiles, first.of(1, 1.0, 8).tiles)
    assert not torch.equal(first.of(1, 1.0, 7).tiles, other.of(1, 1.0, 7).tiles)


def test_everything_is_drawn_where_nothing_is_gained_or_known():
    assert DrawnTiles(rig(), seed=0, steps=LONG).of(0, 1.0, 0) is not None
    assert DrawnTiles(rig(times=LEAST_TIMES - 1), seed=0, steps=LONG).of(0, 1.0, 0) is None, "a camera of few times"
    assert DrawnTiles(rig(moving=None), seed=0, steps=LONG).of(0, 1.0, 0) is None, "unknown what moves"

    def most(share):
        tiles = (np.arange(ROWS * COLUMNS) < share * ROWS * COLUMNS).reshape(ROWS, COLUMNS)
        mask = (tiles * np.uint8(255)).repeat(TILE, 0).repeat(TILE, 1)
        return mask

    threshold = (MOST_DRAWN - SHARE) / (1 - SHARE)
    for share, all_of_it in ((threshold - 0.02, False), (threshold + 0.02, True)):
        views = rig(moving=lambda i, share=share: most(share)[:HEIGHT, :WIDTH])
        assert (DrawnTiles(views, seed=0, steps=LONG).of(0, 1.0, 0) is None) == all_of_it


@pytest.mark.parametrize(
    ("steps", "share"), [(LONG, LEAST_SHARE), (2 * LONG, LEAST_SHARE), (STATIC_STEPS * 2, 0.5), (LONG - 800, 2000 / 7200)]
)
def test_long_trainings_draw_static_tiles_in_as_many_steps_as_they_need(steps, share):
    assert DrawnTiles(rig(), seed=0, steps=steps).share == pytest.approx(share)


def test_short_trainings_draw_everything():
    assert DrawnTiles(rig(), seed=0, steps=STATIC_STEPS).of(0, 1.0, 0) is None
    assert DrawnTiles(rig(), seed=0, steps=0).of(0, 1.0, 0) is None
    assert DrawnTiles(rig(), seed=0, steps=round(1.3 * STATIC_STEPS)).of(0, 1.0, 0) is not None
