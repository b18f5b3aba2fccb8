"""Colours of flow against the wheel's definition, what is out of range or unknown, and weights laid over pictures."""

import colorsys
import math

import numpy as np
import pytest
from e4dgs.vision.flow.colours import colour_wheel, flow_colours, typical_largest
from e4dgs.vision.images.overlay import overlay

# The arcs of the wheel as the paper lists them: how many hues, and the turn of HSV in degrees that they cover.
ARCS = ((15, 0, 60), (6, 60, 120), (4, 120, 180), (11, 180, 240), (13, 240, 300), (6, 300, 360))


def one(u: float, v: float, largest: float = 1.0) -> list[int]:
    return flow_colours(np.array([[[u, v]]], np.float32), largest)[0, 0].tolist()


def expected(angle: float, length: float) -> np.ndarray:
    """The colour of a vector of that direction (radians, from right towards down) and length <= 1, by way of HSV."""
    place = angle / (2 * math.pi) * 55
    for hues, first, last in ARCS:
        if place <= hues:
            pure = colorsys.hsv_to_rgb((first + (last - first) * place / hues) / 360, 1, 1)
            return 255 * (1 - length * (1 - np.array(pure)))
        place -= hues
    raise AssertionError


def test_right_is_red_and_the_other_directions_follow_the_wheel():
    assert one(1, 0) == [255, 0, 0]
    assert one(0, 1) == [255, 234, 0]  # down: 13.75 of the 15 hues from red to yellow
    assert one(-1, 0) == [0, 197, 255]  # left: 27.5, which is 2.5 of the 11 from cyan to blue
    assert one(0, -1) == [103, 0, 255]  # up: 41.25, 5.25 of the 13 from blue to magenta


@pytest.mark.parametrize("length", [0.0, 0.3, 1.0])
def test_every_direction_has_the_colour_of_its_arc(length):
    angles = np.linspace(0, 2 * math.pi, 500, endpoint=False)
    flow = 4.0 * length * np.stack([np.cos(angles), np.sin(angles)], -1)[None]
    found = flow_colours(flow, 4.0)[0]
    wanted = np.array([expected(float(angle), length) for angle in angles])
    assert found.dtype == np.uint8 and np.abs(found - wanted).max() < 0.75  # rounding, and float32 of the vector


def test_no_motion_is_white_and_the_wheel_has_no_seam():
    assert one(0, 0) == [255, 255, 255]
    assert np.abs(np.subtract(one(1, 1e-4), one(1, -1e-4))).max() <= 1


def test_what_is_longer_than_the_largest_is_darker():
    assert one(2, 0, largest=2) == [255, 0, 0]
    assert one(2.01, 0, largest=2) == one(300, 0, largest=2) == [191, 0, 0]


@pytest.mark.parametrize("unknown", [math.nan, math.inf, -math.inf, 1.1e9, -1e10])
def test_unknown_is_black_and_does_not_touch_its_neighbours(unknown):
    flow = np.ones((2, 2, 2), np.float32)
    flow[0, 1, 1] = flow[1, 0, 0] = unknown
    colours = flow_colours(flow)
    assert (colours[0, 1] == 0).all() and (colours[1, 0] == 0).all()
    assert np.array_equal(colours[0, 0], colours[1, 1]) and np.array_equal(colours, flow_colours(flow, typical_largest(flow)))


def test_the_typical_largest_leaves_out_what_is_still_unknown_or_an_outlier():
    flow = np.zeros((100, 100, 2), np.float32)
    assert typical_largest(flow) == typical_largest() == 1.0
    flow[:, :, 0] = 0.2
    flow[:3, :, 1] = 8.0  # 3 of 100 rows move
    flow[0, 0] = 500.0
    flow[1, 0] = math.nan
    assert typical_largest(flow) == pytest.approx(8.0, rel=0.01)
    assert typical_largest(flow, 2 * flow) == pytest.approx(16.0, rel=0.01)
    assert typical_largest(np.full((4, 4, 2), np.inf)) == 1.0


def test_half_floats_are_read_and_wrong_input_is_refused():
    flow = np.random.default_rng(0).normal(0, 3, (5, 7, 2)).astype(np.float16)
    assert np.array_equal(flow_colours(flow, 4.0), flow_colours(flow.astype(np.float64), 4.0))
    assert flow_colours(np.zeros((0, 3, 2))).shape == (0, 3, 3)
    for bad in (np.zeros((4, 4, 3)), np.zeros((4, 4)), np.zeros((4, 4, 2), int)):
        with pytest.raises(ValueError, match=r"flow: expected float \[H, W, 2\]"):
            flow_colours(bad)
    for largest in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(ValueError, match="largest: expected a positive number of px"):
            flow_colours(np.zeros((2, 2, 2)), largest)


def test_the_legend_shows_each_vector_from_its_middle():
    wheel = colour_wheel(101)
    assert wheel.shape == (101, 101, 3) and (wheel[50, 50] == 255).all() and (wheel[0, 0] == 255).all()
    assert np.abs(wheel[50, 100] - expected(0, 100 / 101)).max() < 1
    assert np.abs(wheel[100, 50] - expected(math.pi / 2, 100 / 101)).max() < 1


def test_an_overlay_is_the_colour_at_full_weight_and_the_picture_at_none():
    image = np.full((1, 3, 3), 100, np.uint8)
    weight = np.array([[0, 51, 255]], np.uint8)
    assert overlay(image, weight, (200, 0, 100)).tolist() == [[[100, 100, 100], [120, 80, 100], [200, 0, 100]]]
    assert overlay(image, weight, (200, 0, 100), 0.5)[0, 2].tolist() == [150, 50, 100]
    with pytest.raises(ValueError, match=r"weight: expected uint8 \[1, 3\] like the image"):
        overlay(image, weight[:, :2], (0, 0, 0))
    with pytest.raises(ValueError, match=r"image: expected uint8"):
        overlay(image / 255, weight, (0, 0, 0))
