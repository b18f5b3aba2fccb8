"""Which frame a training step uses: all of them in shuffled rounds, or those of a time window that opens from the middle of the capture.

A rest state learned from all times at once is an average that lacks whatever moved far, so there is nothing for the deformation to
carry. If several cameras see the middle time, the rest state is therefore learned from that time alone. The window then opens step by
step in both directions, so that each new time starts from the motion of its neighbour.
"""

from __future__ import annotations

import numpy as np

MIN_CAMERAS = 4  # cameras at one time that are enough to show its shape without other times
FRONT = 3  # the front is this many of the newest times on either side,
FRONT_OF_ALL = 0.06  # or this share of all times if that is more
FRONT_SHARE = 0.5  # of the steps while the window opens that use a frame of the front


class Curriculum:
    """The frame of each step. It depends only on seed and step, so that a resumed run sees the same frames as an uninterrupted one.

    train [n]: indices of the training frames. time [n] in [0, 1]: their times. first: number of steps on the first window. last: step from
    which all times are included. start: number of times on either side of the middle one in the first window. several: whether the
    middle time alone shows the scene from several sides. With fewer than `MIN_CAMERAS` frames in the first
    window, or if last <= first, all frames are included from the start.
    """

    def __init__(self, train: np.ndarray, time: np.ndarray, seed: int, first: int, last: int, start: int = 0) -> None:
        self.train, self.seed, self.first, self.last, self.start = train, seed, first, last, start
        self.times = np.unique(time)
        self.middle = len(self.times) // 2
        self.distance = np.abs(np.searchsorted(self.times, time) - self.middle)  # times away from the middle one
        self.farthest = int(self.distance.max())
        self.front = max(FRONT, round(FRONT_OF_ALL * len(self.times)))
        self.several = int((self.distance == 0).sum()) >= MIN_CAMERAS
        enough = int((self.distance <= start).sum()) >= MIN_CAMERAS
        self.opens = enough and self.farthest > start and last > first

    def window(self, step: int) -> int:
        """How many times away from the middle one the frames of step ``step`` may be."""
        if not self.opens:
            return self.farthest
        share = (step - self.first) / (self.last - self.first)
        return int(np.clip(self.start + np.ceil(share * (self.farthest - self.start)), self.start, self.farthest))

    def complete(self, step: int) -> bool:
        """Whether all times are included at this step and all later ones."""
        return not self.opens or step >= self.last

    def frame(self, step: int) -> int:
        """Index of the frame that step ``step`` trains on."""
        if self.complete(step):
            epoch, position = divmod(step, len(self.train))
            return int(np.random.default_rng((self.seed, epoch)).permutation(self.train)[position])
        window = self.window(step)
        rng = np.random.default_rng((self.seed, 2, step))
        eligible = self.distance <= window
        if rng.random() < FRONT_SHARE:
            eligible &= self.distance > window - self.front
        return int(rng.choice(self.train[eligible]))

    def probe(self, step: int, count: int) -> list[int]:
        """Up to ``count`` different frames among those that the window includes at ``step``."""
        eligible = self.train[self.distance <= self.window(step)]
        rng = np.random.default_rng((self.seed, 1, step))
        return [int(i) for i in rng.permutation(eligible)[:count]]
