"""Which images are matched with which, and whether they are enlarged for features."""

from __future__ import annotations

import numpy as np

EXHAUSTIVE_LIMIT = 40  # images; 780 pairs
OVERLAP = 4  # following images that each image is matched with, besides those at distances of powers of two up to LONGEST
LONGEST = 64
SMALL = 1200  # px; frames whose longer side is shorter are enlarged for features
MANY = 100  # images; in a longer sequence each feature is seen so often that fewer of them determine the cameras as well
MOST_KEYS = 200  # frames of a sequence; of more, `between/` poses most
MATCHERS = 8  # most processes that match; each has a copy of the features
MOST, STRONGEST = 8192, 3000  # features of an image; of one among many
KEYFRAMES, FEWER_KEYFRAMES = 24, 16  # images spread over a sequence that are all matched with one another, to close loops; fewer among many


def choose(matcher: str | None, images: int, static: bool) -> str:
    """``matcher`` if it is given, else `exhaustive` for few or unordered images, `sequential` for others."""
    if matcher is not None:
        return matcher
    return "exhaustive" if images <= EXHAUSTIVE_LIMIT or static else "sequential"


def image_pairs(matcher: str, images: int, overlap: int = OVERLAP) -> list[tuple[int, int]]:
    """Pairs (a, b), a < b, sorted. `sequential` takes the next `overlap` images; those at powers of two beyond, the farther the fewer,
    since they only tie together what the next images link already; and keyframes. Among `many` images all steps are powers of two, unless
    more of the next ones are asked for."""
    if matcher == "exhaustive":
        return [(a, b) for a in range(images) for b in range(a + 1, images)]
    lean = many(images, False) and overlap <= OVERLAP  # more that are asked for are kept
    near = [step for step in range(1, overlap + 1) if not lean or step & (step - 1) == 0]
    pairs = {(a, a + step) for step in near for a in range(images - step)}
    far = [2**k for k in range(20) if overlap < 2**k <= LONGEST]
    pairs |= {(a, a + step) for step in far for a in range(0, images - step, max(1, step // overlap))}
    stride = max(1, -(-images // (FEWER_KEYFRAMES if lean else KEYFRAMES)))
    keys = range(0, images, stride)
    pairs |= {(a, b) for a in keys for b in keys if a < b}
    return sorted(pairs)


def key_frames(images: int) -> np.ndarray:
    """Numbers of the frames of a sequence that structure from motion uses: all, or of more than `MOST_KEYS` every so many-th. `between/`
    poses the others."""
    return np.arange(0, images, max(1, -(-images // MOST_KEYS)))


def many(images: int, static: bool) -> bool:
    """Whether a sequence is so long that the strongest features of each image are enough."""
    return images > MANY and not static


def enlarged(width: int, height: int, static: bool) -> bool:
    """Whether pictures are enlarged to twice their size for features.

    In an enlarged picture, features are more and lie more exactly. A frame of a large video has enough of them, and to enlarge it would
    take most of the time (vision/DESIGN.md).
    """
    return static or max(width, height) < SMALL
