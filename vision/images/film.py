"""`Film`: which pictures of a film are no new moment of one scene: repeated ones, plain ones, still titles, and cuts to another shot."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

LONGEST = 96  # px, longest side of the pictures that are compared
COARSE = (8, 6)  # px, of those in which only another view differs much
MOST_CHANGED = 0.01  # of the pixels, in which a small object that moves shows
SAME = 4.0  # levels, largest mean difference of the most changed pixels of one picture that was compressed twice
STILLER = 0.125  # of the change from picture to picture before and after, for a repeated one
SHORT = 4  # pictures; a longer run may be a scene in which nothing moves
LEAST_REPEATS, LEAST_SHARE = 3, 0.04
TITLE = 5  # pictures, least of a still title
CUT, CUT_RATIO = 8.0, 3.5  # levels, and ratio to the changes before and after and to the median, from which on a view is another one
PLAIN = 2.5  # levels, standard deviation of a picture of one colour


@dataclass(frozen=True)
class Findings:
    """Numbers of pictures. repeated: those that are the picture before. plain: of one colour. title: of a still picture at the beginning or
    the end, before or after a cut. cuts: the first of another shot."""

    repeated: list[int]
    plain: list[int]
    title: list[int]
    cuts: list[int]


@dataclass
class Film:
    """``add`` what `small` makes of every picture, in order of time, then ask for ``findings``."""

    changes: list[float] = field(default_factory=list)  # from each picture to the next, of the most changed pixels
    jumps: list[float] = field(default_factory=list)  # the same of the coarse pictures
    spreads: list[float] = field(default_factory=list)
    _before: tuple[np.ndarray, np.ndarray] | None = None

    def add(self, picture: np.ndarray) -> None:
        """picture: of whatever size; those of another size than the first are scaled to it."""
        import cv2

        if self._before is not None and picture.shape != self._before[0].shape:
            picture = cv2.resize(picture, self._before[0].shape[::-1], interpolation=cv2.INTER_AREA)
        coarse = cv2.resize(picture, COARSE, interpolation=cv2.INTER_AREA)
        self.spreads.append(float(picture.std()))
        if self._before is not None:
            difference = np.abs(picture - self._before[0]).ravel()
            count = max(1, round(MOST_CHANGED * len(difference)))
            self.changes.append(float(np.partition(difference, -count)[-count:].mean()))
            self.jumps.append(float(np.abs(coarse - self._before[1]).mean()))
        self._before = picture, coarse

    def findings(self) -> Findings:
        changes, jumps = np.array(self.changes), np.array(self.jumps)
        plain = [k for k, spread in enumerate(self.spreads) if spread < PLAIN]
        moving = np.flatnonzero(changes > SAME)
        if not len(moving):  # all may be one still scene
            return Findings([], plain, [], [])
        cuts = [k + 1 for k in moving.tolist() if not {k, k + 1} & set(plain) and _is_cut(jumps, k, float(np.median(jumps[moving])))]
        first, last, count = int(moving[0]), int(moving[-1]), len(self.spreads)
        title = [*range(first + 1)] if first + 1 >= TITLE and first + 1 in cuts else []
        title += [*range(last + 1, count)] if count - last - 1 >= TITLE and last + 1 in cuts else []
        repeated = [k + 1 for a, b in pairwise(moving.tolist()) if b - a - 1 <= SHORT for k in _repeated(changes, a, b)]
        enough = len(repeated) >= max(LEAST_REPEATS, LEAST_SHARE * count)
        # a cut beside a plain picture or a title is told with these
        ends = {first + 1 if 0 in title else -1, last + 1 if count - 1 in title else -1}
        return Findings(repeated if enough else [], sorted({*plain} - {*title}), title, [k for k in cuts if k not in ends])


def small(picture: np.ndarray) -> np.ndarray:
    """What `Film.add` compares, float32 grey, of ``picture``, uint8 [H, W, 3 or 4] RGB."""
    import cv2

    scale = LONGEST / max(picture.shape[:2])
    size = max(1, round(scale * picture.shape[1])), max(1, round(scale * picture.shape[0]))
    reduced = cv2.resize(np.ascontiguousarray(picture[..., :3]), size, interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.cvtColor(reduced, cv2.COLOR_RGB2GRAY), np.float32)


def _is_cut(jumps: np.ndarray, k: int, usual: float) -> bool:
    """Whether the view after picture ``k`` is another one. Two such in a row are a flash."""
    around = [float(jumps[i]) for i in (k - 1, k + 1) if 0 <= i < len(jumps)]
    return bool(jumps[k] >= max(CUT, CUT_RATIO * max([usual, *around])))


def _repeated(changes: np.ndarray, before: int, after: int) -> range | list[int]:
    """The changes between two that are large, if they are much smaller than both."""
    between = changes[before + 1 : after]
    return range(before + 1, after) if len(between) and between.max() <= STILLER * min(changes[before], changes[after]) else []
