"""Watermarks: found where a camera moves behind them, and never taken for one: a scene that stands still, a horizon, a passing caption."""

import cv2
import numpy as np
import pytest
from e4dgs.vision.images.watermark import (
    BORDER,
    LARGEST,
    LEAST_EDGES,
    LEAST_PICTURES,
    PICTURES,
    STILL,
    _find_edges,
    _gradient,
    find_watermark,
    sampled,
)
from factory import Options, make, render
from factory.writers import flatten

WIDTH, HEIGHT = 240, 160


@pytest.fixture(scope="module")
def film():
    """A camera that moves through a room, 16 pictures [160, 240, 3]."""
    synthetic = make(Options(backdrop="room", rig="path", times=16, width=WIDTH, height=HEIGHT, fov_degrees=60.0, samples=1))
    return [flatten(render(synthetic.scene, view.camera, view.time, 1)) for view in synthetic.views]


def drawn(picture, text="Logo", at=(150, 140), scale=0.8, colour=(235, 235, 235)):
    return cv2.putText(picture.copy(), text, at, cv2.FONT_HERSHEY_SIMPLEX, scale, colour, 2, cv2.LINE_AA)


def letters(**options):
    return (drawn(np.zeros((HEIGHT, WIDTH, 3), np.uint8), **options) > 0).any(-1)


def compressed(picture, quality=60):
    return cv2.imdecode(cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])[1], cv2.IMREAD_COLOR)


def test_letters_are_covered_and_little_else(film):
    found = find_watermark([compressed(drawn(picture)) for picture in film])
    assert found.shape == (HEIGHT, WIDTH) and found.dtype == bool
    ink = letters()
    around = cv2.dilate(ink.astype(np.uint8), np.ones((17, 17))) > 0
    box = np.zeros_like(ink)
    rows, columns = np.nonzero(around)
    box[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1] = True
    assert found[ink].mean() > 0.97
    assert not found[~box].any()


def test_a_film_without_one(film):
    assert find_watermark(film) is None


def test_faint_letters_beside_clear_ones_belong_to_it(film):
    def both(picture):
        faint = drawn(picture, "tv", (205, 140))
        return drawn(np.rint(0.75 * picture + 0.25 * faint).astype(np.uint8))

    found = find_watermark([both(picture) for picture in film])
    assert found[letters(text="tv", at=(205, 140))].mean() > 0.9
    alone = [np.rint(0.75 * picture + 0.25 * drawn(picture, "tv", (205, 140))).astype(np.uint8) for picture in film]
    assert find_watermark(alone) is None, "faint ones alone are not enough"


def test_pictures_larger_than_those_looked_at(film):
    large = [cv2.resize(drawn(picture), (5 * WIDTH, 5 * HEIGHT), interpolation=cv2.INTER_CUBIC) for picture in film]
    found = find_watermark(large)
    assert found.shape == (5 * HEIGHT, 5 * WIDTH)
    ink = cv2.resize(letters().astype(np.uint8), (5 * WIDTH, 5 * HEIGHT), interpolation=cv2.INTER_NEAREST) > 0
    assert found[ink].mean() > 0.99


def test_a_camera_that_stands_still(film):
    noise = np.random.default_rng(0)
    still = [np.clip(drawn(film[0]) + noise.normal(0, 2, film[0].shape), 0, 255).astype(np.uint8) for _ in film]
    assert find_watermark(still) is None


@pytest.mark.parametrize(("moving", "found"), [(0.8, False), (0.97, True)])
def test_where_most_of_the_image_stands_still(film, moving, found):
    """A part of the first picture beside the film: the camera counts as moving while few of the edges are steady."""
    columns = round((1 - moving) * WIDTH)
    pictures = [drawn(picture) for picture in film]
    for picture in pictures:
        picture[:, :columns] = film[0][:, :columns]
    share = _find_edges(np.stack([_gradient(picture) for picture in pictures])).share
    assert (share <= STILL) == found
    assert (find_watermark(pictures) is not None) == found


def test_what_the_camera_circles(film):
    """It stands still in the middle of the image, as a logo does near the border."""
    assert find_watermark([drawn(picture, at=(90, 90)) for picture in film]) is None
    assert find_watermark([drawn(picture, at=(90, 30)) for picture in film]) is not None


def test_edges_of_one_direction_are_a_horizon(film):
    def horizon(picture):
        picture = picture.copy()
        picture[130:] = 20
        picture[124:130] = 220
        return picture

    pictures = [horizon(picture) for picture in film]
    edges = _find_edges(np.stack([_gradient(picture) for picture in pictures]))
    assert edges.steady.sum() > LEAST_EDGES and edges.share <= STILL, "only their direction tells"
    assert find_watermark(pictures) is None


@pytest.mark.parametrize(("shown", "found"), [(0.7, False), (0.9, True)])
def test_a_caption_that_passes(film, shown, found):
    pictures = [drawn(picture) if i < shown * len(film) else picture for i, picture in enumerate(film)]
    assert (find_watermark(pictures) is not None) == found


def test_what_covers_much_of_the_image_is_none(film):
    options = {"text": "LOGO LOGO", "at": (2, 158), "scale": 1.3}
    rows, columns = np.nonzero(letters(**options))
    assert rows.min() >= (1 - BORDER) * HEIGHT, "near the border"
    assert np.ptp(rows) * np.ptp(columns) > LARGEST * WIDTH * HEIGHT
    assert find_watermark([drawn(picture, **options) for picture in film]) is None


def test_how_many_pictures_it_takes(film):
    pictures = [drawn(picture) for picture in film]
    assert find_watermark(pictures[: LEAST_PICTURES - 1]) is None
    assert find_watermark(pictures[:LEAST_PICTURES]) is not None
    assert sampled(LEAST_PICTURES - 1) == [] and sampled(LEAST_PICTURES) == list(range(LEAST_PICTURES))
    many = sampled(1000)
    assert len(many) == PICTURES and many[0] == 0 and many[-1] == 999 and np.ptp(np.diff(many)) <= 1
