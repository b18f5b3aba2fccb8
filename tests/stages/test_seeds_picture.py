"""The picture of where training begins shows each seed where its camera sees it, what is near before what is far."""

import numpy as np
from e4dgs.scene.seeds.moving.moving_seeds import MovingSeeds
from e4dgs.scene.seeds.picture import DIMMED, MOVING, seeds_picture
from e4dgs.scene.views import Views

WIDTH, HEIGHT = 64, 48


def views() -> Views:
    K = np.array([[40.0, 0, WIDTH / 2], [0, 40, HEIGHT / 2], [0, 0, 1]])
    picture = np.full((HEIGHT, WIDTH, 3), 200, np.uint8)
    index = np.arange(3)
    return Views(
        np.tile(K, (3, 1, 1)),
        np.tile(np.eye(4), (3, 1, 1)),
        index / 2,
        np.zeros(3, int),
        np.full(3, -1),
        index,
        WIDTH,
        HEIGHT,
        lambda i: picture,
    )


def test_seeds_lie_where_the_camera_sees_them():
    points = np.array([[0.0, 0, 4], [0, 0, 2], [1, 0, 4], [0, 0, -4]])
    colors = np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]])
    picture = seeds_picture(views(), points, colors, None)
    assert picture.shape == (HEIGHT, WIDTH, 3) and picture.dtype == np.uint8
    assert picture[24, 32].tolist() == [0, 255, 0], "the nearer of two"
    assert picture[24, 42].tolist() == [0, 0, 255]
    assert picture[5, 5].tolist() == [int(DIMMED * 200)] * 3
    assert not (picture == 255).all(-1).any(), "what is behind the camera is not shown"


def test_what_moves_has_a_rim_and_is_shown_at_the_picture_s_time_alone():
    moving = MovingSeeds(np.array([[-1.0, 0, 4], [1, 0, 4]]), np.array([[0.0, 0, 1]] * 2), np.zeros((2, 3)), np.array([0.4, 1.0]))
    picture = seeds_picture(views(), np.zeros((0, 3)), np.zeros((0, 3)), moving)
    assert picture[24, 22].tolist() == [0, 0, 255] and picture[24, 24].tolist() == list(MOVING)
    assert picture[24, 42].tolist() == [int(DIMMED * 200)] * 3
