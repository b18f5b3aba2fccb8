"""Depth of any kind is aligned to known points: exactly without noise, robustly with it, and as smoothly over time as it allows."""

import numpy as np
import pytest
from e4dgs.vision.depth.align import FEWEST, INVERSE, KINDS, METRIC, SCALE, Sample, align
from e4dgs.vision.depth.over_time import smooth_over_time, steadied

FRAMES = 24
MADE = {  # of each kind, the value of a pixel at depth z, with a scale and a shift
    SCALE: lambda z, scale, shift: scale * z,
    "up to scale and shift": lambda z, scale, shift: scale * (z + 30 * shift),
    INVERSE: lambda z, scale, shift: scale * (1 / z + shift),
    "up to scale and shift of the inverse": lambda z, scale, shift: scale / (1 / z + shift),
}


def jumping(rng):
    """Scales and shifts that have nothing to do with one another."""
    return np.exp(rng.uniform(-0.7, 0.7, FRAMES)), rng.uniform(0.01, 0.15, FRAMES)


def made(kind, scale, shift, noise=0.0, moving=0.0, wrong=0.0, smooth=0.0, count=400, seed=0):
    """Samples by frame. noise: of each point, relative. smooth: the same, but equal within a ninth of the picture. moving: share of the
    points that something at two thirds of their depth hides. wrong: share that are anywhere."""
    samples, rng = {}, np.random.default_rng(seed)
    for k in range(FRAMES):
        z, place = rng.uniform(3, 9, count), rng.random((count, 2))
        shown = np.where(place[:, 0] < moving, 2 * z / 3, z) * np.exp(noise * rng.normal(size=count))
        shown *= np.exp(smooth * rng.normal(size=(3, 3)))[tuple((3 * place).astype(int).T)]
        shown = np.where(rng.random(count) < wrong, rng.uniform(1, 30, count), shown)
        samples[k] = Sample(MADE[kind](shown, scale[k], shift[k]), z, place)
    return samples


def off(aligned, kind, scale, shift, frames=range(FRAMES), z=(2.0, 3.5, 5.0, 8.0)):
    """[frames, z] relative errors of the aligned depth; the first is nearer than all points."""
    z = np.array([z])
    return np.array([aligned.depth(k, MADE[kind](z, scale[k], shift[k])) / z - 1 for k in frames])[:, 0]


@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_is_recognised_and_fitted(kind):
    scale, shift = jumping(np.random.default_rng(1))
    aligned = align(made(kind, scale, shift), [range(FRAMES)])
    assert aligned.kind == kind and aligned.error < 1e-3
    assert np.abs(off(aligned, kind, scale, shift)).max() < 2e-3


@pytest.mark.parametrize("kind", KINDS)
def test_the_kind_is_recognised_with_noise_and_movers(kind):
    scale, shift = jumping(np.random.default_rng(2))
    aligned = align(made(kind, scale, shift, noise=0.02, moving=0.3, wrong=0.1), [range(FRAMES)])
    assert aligned.kind == kind
    assert np.median(np.abs(off(aligned, kind, scale, shift))) < 0.02


@pytest.mark.parametrize(("shift", "kind"), [(0.02, "up to scale and shift"), (0.0, SCALE)])
def test_noise_does_not_hide_a_shift_that_nearer_things_show(shift, kind):
    """Known points are from 3 to 9 away: a factor alone explains them nearly as well, and is off by much at 2."""
    scale = jumping(np.random.default_rng(3))[0]
    shifts = np.full(FRAMES, shift)
    aligned = align(made("up to scale and shift", scale, shifts, noise=0.06, smooth=0.05), [range(FRAMES)])
    assert aligned.kind == kind
    assert abs(np.median(off(aligned, "up to scale and shift", scale, shifts, z=(2.0,)))) < 0.03


def test_one_factor_for_all_frames_is_metric():
    scale = np.full(FRAMES, 1000.0)
    aligned = align(made(SCALE, scale, scale, noise=0.03), [range(FRAMES)])
    assert aligned.kind == METRIC and len({one[0] for one in aligned.fits.values()}) == 1
    assert np.abs(off(aligned, SCALE, scale, scale)).max() < 2e-3


@pytest.mark.parametrize(("moving", "wrong"), [(0.3, 0.0), (0.0, 0.3), (0.3, 0.1)])
def test_movers_and_wrong_points_do_not_spoil_the_fit(moving, wrong):
    scale, shift = jumping(np.random.default_rng(3))
    aligned = align(made(INVERSE, scale, shift, noise=0.01, moving=moving, wrong=wrong), [range(FRAMES)], [INVERSE])
    assert np.median(np.abs(off(aligned, INVERSE, scale, shift))) < 0.01
    assert np.abs(off(aligned, INVERSE, scale, shift)).max() < 0.06


def test_noise_does_not_flatten_the_scale():
    """Least squares of depth on noisy values would put what is nearer than all points 20 % too far."""
    scale, shift = jumping(np.random.default_rng(4))
    aligned = align(made(INVERSE, scale, shift, noise=0.1, count=1500), [range(FRAMES)], [INVERSE])
    assert abs(off(aligned, INVERSE, scale, shift, z=(1.5,)).mean()) < 0.015


def test_what_is_steady_is_smoothed_over_time():
    scale, shift = np.full(FRAMES, 2.0), np.full(FRAMES, 0.1)
    samples = made(INVERSE, scale, shift, smooth=0.05)
    together = align(samples, [range(FRAMES)], [INVERSE])
    alone = align(samples, [[k] for k in range(FRAMES)], [INVERSE])
    smoothed, single = (np.sqrt((off(one, INVERSE, scale, shift) ** 2).mean()) for one in (together, alone))
    assert smoothed < 0.7 * single and single > 0.015


def test_what_jumps_is_not_smoothed():
    scale, shift = jumping(np.random.default_rng(5))
    samples = made(INVERSE, scale, shift, smooth=0.05)
    together = align(samples, [range(FRAMES)], [INVERSE])
    alone = align(samples, [[k] for k in range(FRAMES)], [INVERSE])
    smoothed, single = (np.sqrt((off(one, INVERSE, scale, shift) ** 2).mean()) for one in (together, alone))
    assert smoothed < 1.15 * single


def test_frames_with_few_points_are_aligned_as_their_neighbours_where_these_agree():
    steady, jumps = (np.full(FRAMES, 2.0), np.full(FRAMES, 0.1)), jumping(np.random.default_rng(6))
    for (scale, shift), there in ((steady, True), (jumps, False)):
        samples = made(INVERSE, scale, shift)
        samples[7] = Sample(*(of[: FEWEST - 1] for of in samples[7]))
        del samples[0]
        aligned = align(samples, [range(FRAMES)], [INVERSE])
        assert (7 in aligned.fits) is (0 in aligned.fits) is there
        if there:
            assert np.isnan(aligned.errors[7]) and np.abs(off(aligned, INVERSE, scale, shift)).max() < 2e-3


def test_what_no_point_tells_is_unknown():
    scale, shift = np.full(FRAMES, 2.0), np.full(FRAMES, 0.1)
    aligned = align(made(INVERSE, scale, shift), [range(FRAMES)], [INVERSE])
    values = np.array([[0.0, 2 * (1 / 5 + 0.1), 2 * 0.1, 0.01]])  # unknown, 5, infinitely far, behind infinity
    assert aligned.depth(3, values)[0] == pytest.approx([0, 5, 0, 0], rel=1e-3)


def test_without_points_there_is_none():
    assert align({}, [range(FRAMES)]) is None
    assert align({0: Sample(np.ones(FEWEST - 1), np.ones(FEWEST - 1), np.zeros((FEWEST - 1, 2)))}, [[0]]) is None


@pytest.mark.parametrize("kind", KINDS)
def test_values_that_tell_nothing_are_refused(kind):
    samples = made(kind, *jumping(np.random.default_rng(7)))
    rng = np.random.default_rng(0)
    assert align({k: Sample(rng.permutation(one.value), one.z, one.place) for k, one in samples.items()}, [range(FRAMES)]) is None
    falling = {k: Sample(one.value.max() + 1 - one.value, one.z, one.place) for k, one in samples.items()}
    assert align(falling, [range(FRAMES)], [kind]) is None


def test_points_at_one_depth_give_a_factor():
    same = {k: Sample(np.full(50, 3.0), np.full(50, 6.0), np.random.default_rng(k).random((50, 2))) for k in range(4)}
    aligned = align(same, [range(4)])
    assert aligned.kind == METRIC and aligned.depth(0, np.full((1, 1), 3.0))[0, 0] == pytest.approx(6.0)


def test_a_walk_keeps_a_step_and_gives_up_noise():
    rng, true = np.random.default_rng(0), np.where(np.arange(40) < 20, 1.0, 1.5)
    noisy = true + 0.02 * rng.normal(size=40)
    course = smooth_over_time(range(40), {k: noisy[[k]] for k in range(40)}, {k: np.array([0.02**2]) for k in range(40)}, 0.02)
    found = np.array([course[k][0] for k in range(40)])
    assert np.abs(found - true).max() < 0.025 and np.abs(found - true).mean() < 0.6 * np.abs(noisy - true).mean()


@pytest.mark.parametrize(("noise", "walk", "share"), [(0.12, 0.01, 0.75), (0.03, 0.03, 1.0), (0.12, 0.0, 0.65)])
def test_what_is_steadied_is_nearer_to_the_truth_than_a_moving_median(noise, walk, share):
    """As smooth as the values are themselves: a fixed window is too short for noise, and too long for what changes."""
    off = {"steadied": [], "median": []}
    for seed in range(10):
        rng = np.random.default_rng(seed)
        true = np.cumsum(walk * rng.normal(size=90))
        seen = true + noise * rng.normal(size=90) + np.where(rng.random(90) < 0.05, 0.5, 0.0)
        median = np.array([np.median(seen[max(0, k - 4) : k + 5]) for k in range(90)])
        off["steadied"].append(np.sqrt(np.mean((steadied(range(90), seen) - true) ** 2)))
        off["median"].append(np.sqrt(np.mean((median - true) ** 2)))
    assert np.mean(off["steadied"]) < share * np.mean(off["median"])


def test_few_values_and_frames_with_gaps_are_steadied():
    assert steadied([], []).shape == (0,) and steadied([3], [1.5]).tolist() == [1.5]
    frames = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 20, 21, 22, 23, 24, 25, 26, 27, 28, 29]
    line = np.array(frames) / 30
    assert np.allclose(steadied(frames, line), line, atol=0.08)
    assert np.allclose(steadied(frames, np.full(20, 2.0)), 2.0)
