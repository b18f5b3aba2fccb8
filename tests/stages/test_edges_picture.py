"""The picture of edges: what both show, what the render lost, and what it made up."""

import numpy as np
import pytest
from e4dgs.stages.evaluate.pictures.edge_colours import ADDED, BOTH, MISSING
from e4dgs.stages.evaluate.pictures.edges import GROUND, edges_picture


def squares(*corners: tuple[int, int]) -> np.ndarray:
    """White squares of 16 x 16 px, uint8 [64, 80, 3]."""
    picture = np.zeros((64, 80, 3), np.uint8)
    for y, x in corners:
        picture[y : y + 16, x : x + 16] = 255
    return picture


def where(picture: np.ndarray, colour: tuple[int, int, int]) -> np.ndarray:
    return (picture == colour).all(-1)


def test_each_kind_of_edge_has_its_colour_and_place():
    shown = edges_picture(squares((8, 8), (40, 8)), squares((8, 8), (8, 50)))
    parts = {colour: where(shown, colour) for colour in (GROUND, BOTH, MISSING, ADDED)}
    assert sum(part.sum() for part in parts.values()) == 64 * 80, "no other colour"
    for colour, (y, x) in ((BOTH, (8, 8)), (MISSING, (8, 50)), (ADDED, (40, 8))):
        rows, columns = np.nonzero(parts[colour])
        assert (
            abs(rows.min() - y) <= 1 and abs(rows.max() - y - 16) <= 1 and abs(columns.min() - x) <= 1 and abs(columns.max() - x - 16) <= 1
        )


@pytest.mark.parametrize(("shift", "same"), [(1, True), (4, False)])
def test_an_edge_a_pixel_away_is_the_same_one(shift, same):
    shown = edges_picture(squares((20, 20 + shift)), squares((20, 20)))
    left = np.s_[26:32, 12:32]  # the left side of the square, without its corners
    assert (where(shown, MISSING)[left].any() or where(shown, ADDED)[left].any()) != same
    assert where(shown, BOTH)[left].any() == same


def test_pictures_without_edges_are_empty():
    assert where(edges_picture(squares(), squares()), GROUND).all()
