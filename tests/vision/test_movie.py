"""Pictures in, an MP4 out."""

import io
from fractions import Fraction

import av
import numpy as np
import pytest
from e4dgs.vision.images.movie import encode_movie


def test_the_same_pictures_give_the_same_bytes():
    """Whatever the memory held before that the encoder is given: it once wrote another file in every run."""
    rng = np.random.default_rng(0)
    waves = [np.sin(np.arange(64)[None, :, None] / 9 + k / 5) for k in range(60)]
    pictures = [np.clip(128 + 60 * wave + rng.normal(0, 20, (48, 64, 3)), 0, 255).astype(np.uint8) for wave in waves]
    found = set()
    for _ in range(4):
        used = [np.full(int(size), 255, np.uint8) for size in rng.integers(1000, 40_000, 20)]
        found.add(encode_movie(iter(pictures), 15.0))
        del used
    assert len(found) == 1


@pytest.mark.parametrize(
    ("fps", "rate"),
    [
        (23.976, Fraction(24000, 1001)),
        (23.98, Fraction(24000, 1001)),
        (29.97, Fraction(30000, 1001)),
        (59.94, Fraction(60000, 1001)),
        (12.5, Fraction(25, 2)),
        (0.999, Fraction(999, 1000)),
        (0.004, Fraction(1, 250)),
        (24.0, Fraction(24)),
    ],
)
def test_a_movie_has_the_rate_that_was_asked_for(fps, rate):
    with av.open(io.BytesIO(encode_movie([np.zeros((8, 8, 3), np.uint8)] * 5, fps))) as movie:
        assert movie.streams.video[0].average_rate == rate


@pytest.mark.parametrize(("size", "encoded"), [((1, 7), (2, 6)), ((9, 1), (8, 2)), ((1, 1), (2, 2))])
def test_pictures_of_any_size_can_be_encoded(size, encoded):
    with av.open(io.BytesIO(encode_movie([np.full((*size, 3), 200, np.uint8)] * 3, 15.0))) as movie:
        frames = list(movie.decode(video=0))
    assert [(frame.height, frame.width) for frame in frames] == [encoded] * 3
