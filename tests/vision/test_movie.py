"""Pictures in, an MP4 out."""

import numpy as np
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
