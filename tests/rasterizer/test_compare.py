"""The comparison helpers can fail: each of their checks catches the fault that it is for."""

from dataclasses import replace

import pytest
import torch
from e4dgs.rasterizer import Frame

from .compare import assert_gradients_close, assert_images_close, decided_by_threshold
from .scenes import random_scene, stack

NONE = torch.zeros(20, 30, dtype=torch.bool)


def make_frame(seed: int = 0) -> Frame:
    g = torch.Generator().manual_seed(seed)
    color, alpha, depth, extras = (torch.rand(20, 30, *c, generator=g, dtype=torch.float64) for c in ((3,), (), (), (2,)))
    nobody = torch.zeros(0, dtype=torch.bool)
    return Frame(color, alpha, depth, extras, nobody, nobody)


def changed(frame: Frame, name: str, by: torch.Tensor | float) -> Frame:
    return replace(frame, **{name: getattr(frame, name) + by})


def test_equal_images_pass() -> None:
    assert_images_close(make_frame(), make_frame(), NONE)


@pytest.mark.parametrize("name", ["color", "alpha", "depth", "extras"])
def test_one_wrong_pixel_is_caught(name: str) -> None:
    wrong = torch.zeros_like(getattr(make_frame(), name))
    wrong[3, 4] = 1e-4
    with pytest.raises(AssertionError, match=f"{name} differs"):
        assert_images_close(changed(make_frame(), name, wrong), make_frame(), NONE)


def test_small_bias_is_caught_though_no_pixel_is_far_off() -> None:
    with pytest.raises(AssertionError, match="biased"):
        assert_images_close(changed(make_frame(), "alpha", 5e-6), make_frame(), NONE)


def test_small_noise_without_bias_passes() -> None:
    sign = torch.ones(20, 30, dtype=torch.float64)
    sign[::2] = -1
    assert_images_close(changed(make_frame(), "alpha", 1e-5 * sign), make_frame(), NONE)


def test_nan_is_caught() -> None:
    with pytest.raises(AssertionError, match="not finite"):
        assert_images_close(changed(make_frame(), "depth", float("nan")), make_frame(), NONE)


def test_flips_are_allowed_only_where_a_threshold_decides_and_only_few_and_small() -> None:
    decided = NONE.clone()
    decided[0, :10] = True
    wrong = torch.zeros(20, 30, dtype=torch.float64)
    wrong[0, :4] = 0.004
    assert_images_close(changed(make_frame(), "alpha", wrong), make_frame(), decided)
    with pytest.raises(AssertionError, match="differs"):
        assert_images_close(changed(make_frame(), "alpha", wrong), make_frame(), NONE)
    with pytest.raises(AssertionError, match="flips"):
        assert_images_close(changed(make_frame(), "alpha", 2 * decided * 0.004), make_frame(), decided)
    with pytest.raises(AssertionError, match="where a threshold decides"):
        assert_images_close(changed(make_frame(), "alpha", 100 * wrong), make_frame(), decided)


def test_too_many_undecided_pixels_are_caught() -> None:
    with pytest.raises(AssertionError, match="too few"):
        assert_images_close(make_frame(), make_frame(), ~NONE)


def test_gradients_must_agree_in_length_direction_and_sign() -> None:
    want = {"x": torch.randn(50, generator=torch.Generator().manual_seed(1), dtype=torch.float64)}
    assert_gradients_close(want, want)
    with pytest.raises(AssertionError, match="relative L2"):
        assert_gradients_close({"x": 1.002 * want["x"]}, want)
    turned = want["x"].clone()
    turned[0] += 5e-3 * want["x"].norm()
    with pytest.raises(AssertionError, match="cosine"):
        assert_gradients_close({"x": turned}, want, relative=1e-2)
    with pytest.raises(AssertionError, match="biased"):
        assert_gradients_close({"x": want["x"] + 3e-4}, want, bias=1e-4)
    with pytest.raises(AssertionError, match="not finite"):
        assert_gradients_close({"x": want["x"] * float("inf")}, want)


def test_zero_gradients_must_be_zero_and_none_may_be_missing() -> None:
    zero = {"x": torch.zeros(3, dtype=torch.float64)}
    assert_gradients_close(zero, zero)
    with pytest.raises(AssertionError, match="must be zero"):
        assert_gradients_close({"x": zero["x"] + 1e-12}, zero)
    with pytest.raises(AssertionError, match="expected"):
        assert_gradients_close({}, zero)


def test_pixels_at_a_threshold_are_found() -> None:
    assert bool(decided_by_threshold(stack(3, 1 / 255 + 1e-6)).all())
    assert bool(decided_by_threshold(stack(3, 0.99 - 1e-6)).all())
    assert not bool(decided_by_threshold(stack(3, 0.5)).any())
    stopping = 1 - 0.99e-4 ** (1 / 3)  # the third layer lands on the stop
    assert bool(decided_by_threshold(stack(3, stopping)).all())


def test_few_pixels_of_an_ordinary_scene_are_at_a_threshold() -> None:
    share = decided_by_threshold(random_scene(1, gaussians=30, convexes=10)).double().mean()
    assert 0 <= float(share) < 0.03
