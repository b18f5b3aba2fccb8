"""Black bars around pictures of another shape: found to the pixel, and never taken for one: a dark sky, or black behind an object."""

import cv2
import numpy as np
import pytest
from e4dgs.vision.images.black_bars import BLUR, BarFinder

HEIGHT, WIDTH = 180, 320


def film(count=6):
    """A camera that passes a bright wall of blocks."""
    wall = (np.random.default_rng(3).random((30, 60, 3)) * 200 + 30).astype(np.uint8).repeat(8, 0).repeat(8, 1)
    return [wall[8 : 8 + HEIGHT, 4 * k : 4 * k + WIDTH].copy() for k in range(count)]


def framed(pictures, left=0, top=0, right=0, bottom=0, level=0):
    for picture in pictures:
        inside = picture[top : HEIGHT - bottom, left : WIDTH - right].copy()
        picture[:] = level
        picture[top : HEIGHT - bottom, left : WIDTH - right] = inside
    return pictures


def found(pictures, quality=None):
    finder = BarFinder()
    for picture in pictures:
        if quality:
            picture = cv2.imdecode(cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])[1], cv2.IMREAD_COLOR)
        finder.add(picture)
    return finder.found


@pytest.mark.parametrize("bars", [(0, 24, 0, 24), (90, 0, 90, 0), (40, 20, 40, 24), (0, 3, 0, 4)])
@pytest.mark.parametrize("level", [0, 16])
def test_bars_are_found(bars, level):
    expected = tuple(size + BLUR if size else 0 for size in bars)
    assert found(framed(film(), *bars, level=level)) == expected
    if min(size for size in bars if size) > 16:  # the blocks of compressed colours
        blurred = found(framed(film(), *bars, level=level), quality=80)
        assert blurred is not None and np.abs(np.subtract(blurred, expected)).max() <= 3


def test_a_dark_sky_or_one_dark_side_is_none():
    assert found(film()) is None
    assert found(framed(film(), top=20)) is None
    assert found(framed(film(), top=20, bottom=6)) is None
    assert found(framed(film(), top=12, bottom=12, level=60)) is None


def test_black_behind_an_object_is_none():
    pictures = []
    for k in range(12):
        picture = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
        cv2.ellipse(picture, (160, 90), (100, 60), 4 * k, 0, 360, (200, 150, 90), -1)
        pictures.append(picture)
    assert found(pictures) is None


def test_pictures_that_fade_from_black_have_bars_all_the_same():
    pictures = framed(film(), top=12, bottom=12)
    assert found([np.zeros_like(pictures[0]), *pictures]) == (0, 14, 0, 14)
    assert found([np.zeros_like(pictures[0])] * 3) is None
