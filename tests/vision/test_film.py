"""Pictures of a film that are no new moment: repeats, plain pictures, titles and cuts; and what only looks like them."""

import cv2
import numpy as np
import pytest
from e4dgs.vision.images.film import TITLE, Film, Findings, small

RNG = np.random.default_rng(3)
WALL = cv2.GaussianBlur((RNG.random((22, 80, 3)) * 255).astype(np.uint8).repeat(8, 0).repeat(8, 1), (0, 0), 2)


def moment(k, noise=2.0):
    """What a camera that passes a wall sees, with its noise, compressed."""
    picture = np.clip(WALL[8:128, 3 * k : 3 * k + 160] + RNG.normal(0, noise, (120, 160, 3)), 0, 255).astype(np.uint8)
    return cv2.imdecode(cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 90])[1], cv2.IMREAD_COLOR)


def findings(pictures):
    film = Film()
    for picture in pictures:
        film.add(small(picture))
    return film.findings()


def again(picture, quality):
    """The same picture, compressed once more, as an encoder does with a repeated one."""
    return cv2.imdecode(cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])[1], cv2.IMREAD_COLOR)


NOTHING = Findings([], [], [], [])


def test_a_camera_that_moves_shows_nothing_odd():
    assert findings([moment(k) for k in range(40)]) == NOTHING
    assert findings([moment(k) for k in range(0, 80, 4)]) == NOTHING


@pytest.mark.parametrize("quality", [98, 95])
def test_repeats_of_a_raised_rate_are_found(quality):
    seen = [moment(k) for k in range(32)]  # 24 pictures a second, shown as 30
    film = [again(seen[k * 4 // 5], quality) if k * 4 // 5 == (k - 1) * 4 // 5 else seen[k * 4 // 5] for k in range(40)]
    found = findings(film)
    assert found.repeated == [k for k in range(2, 40) if k * 4 // 5 == (k - 1) * 4 // 5] and not found.plain + found.title + found.cuts


def test_few_repeats_and_things_that_stop_for_a_while_are_none():
    seen = [moment(k) for k in range(40)]
    assert findings([*seen[:20], seen[19], *seen[20:]]) == NOTHING
    assert findings([*seen[:20], *[moment(20) for _ in range(12)], *seen[21:]]) == NOTHING

    def ball(x):
        return cv2.circle(moment(0), (x, 60), 6, (20, 60, 250), -1)

    assert findings([ball(20 + 3 * min(k, 15) if k < 25 else 20 + 3 * (k - 10)) for k in range(40)]) == NOTHING
    assert findings([moment(0)] * 30) == NOTHING


def test_plain_pictures_and_titles_at_the_ends_are_found():
    seen = [moment(k) for k in range(30)]
    black = np.zeros_like(seen[0])
    assert findings([black, black, *seen, black]) == Findings([], [0, 1, 32], [], [])
    title = cv2.putText(np.full_like(black, 40), "TITLE", (20, 70), cv2.FONT_HERSHEY_SIMPLEX, 1.2, (255, 255, 255), 3)
    assert findings([title] * TITLE + seen) == Findings([], [], [*range(TITLE)], [])
    assert findings(seen + [title] * 9).title == [*range(30, 39)]


def test_cuts_are_found_and_flashes_are_none():
    seen = [moment(k) for k in range(30)]
    others = [np.roll(picture, 60, 0) // 3 for picture in seen]
    assert findings(seen[:12] + others[:18]) == Findings([], [], [], [12])
    bright = np.clip(seen[12].astype(int) + 120, 0, 255).astype(np.uint8)
    assert findings([*seen[:12], bright, *seen[13:]]) == NOTHING


def test_pictures_of_several_sizes_are_compared():
    seen = [moment(k) for k in range(12)]
    assert findings([picture if k % 3 else np.ascontiguousarray(picture.transpose(1, 0, 2)) for k, picture in enumerate(seen)]) == NOTHING
    assert findings([cv2.resize(picture, (80 + 8 * k, 60 + 6 * k)) for k, picture in enumerate(seen)]) == NOTHING
