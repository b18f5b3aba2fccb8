"""Pictures in, an MP4 out."""

import io
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest
from av.video.reformatter import ColorRange, Colorspace
from e4dgs.vision.images.movie import encode_movie, even, movie_file


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


def test_a_relative_name_may_have_a_colon(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with movie_file(Path("take10:30.mp4"), 15.0) as movie:
        movie.add(np.zeros((8, 8, 3), np.uint8))
    assert [file.name for file in tmp_path.iterdir()] == ["take10:30.mp4"] and (tmp_path / "take10:30.mp4").stat().st_size


COLOURS = np.array([[203, 48, 34], [30, 200, 60], [20, 40, 220], [255, 255, 255], [0, 0, 0], [128, 128, 128], [240, 200, 10]], np.uint8)


@pytest.mark.parametrize("width", [160, 1280])
def test_colours_come_back_for_whoever_reads_the_tags(width):
    """Whatever the size, by which players guess where there are no tags."""
    wide = width // len(COLOURS)
    picture = np.repeat(np.repeat(COLOURS[None], 64, 0), wide, 1)
    with av.open(io.BytesIO(encode_movie([picture] * 3, 30.0))) as movie:
        codec = movie.streams.video[0].codec_context
        assert [codec.colorspace, codec.color_primaries, codec.color_trc, codec.color_range] == [1, 1, 1, ColorRange.MPEG]  # 1: BT.709
        frame = next(movie.decode(video=0))
        assert (frame.colorspace, frame.color_range) == (Colorspace.ITU709, ColorRange.MPEG)
        luma = np.frombuffer(frame.planes[0], np.uint8).reshape(-1, frame.planes[0].line_size)
        # Shown by the formulas of ITU-R BT.709, not by what a converter takes the tags for.
        y, cb, cr = (np.frombuffer(plane, np.uint8).reshape(-1, plane.line_size).astype(float) for plane in frame.planes)
        at = np.arange(len(COLOURS)) * wide + wide // 2
        y, cb, cr = (y[32, at] - 16) / 219, (cb[16, at // 2] - 128) / 224, (cr[16, at // 2] - 128) / 224
    red, blue = y + 1.5748 * cr, y + 1.8556 * cb
    green = (y - 0.2126 * red - 0.0722 * blue) / 0.7152
    assert np.abs(255 * np.stack([red, green, blue], 1) - COLOURS).max() <= 3
    assert luma[32, at[3]] == 235 and luma[32, at[4]] == 16, "the range of television"


def test_even_sizes():
    assert [even(size) for size in (1, 2, 3, 160, 161)] == [2, 2, 2, 160, 160]
