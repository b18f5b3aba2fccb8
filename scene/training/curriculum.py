"""Which frame a training step looks at: all of them in shuffled rounds, or a window of times that opens from the middle of the capture.

A rest state that is learned from all times at once is an average, and what moved far is not in it: nothing is left that the
deformation could carry. Where several cameras see one time, the rest state is therefore learned from the middle time alone, and the
window opens step by step in both directions, so that each new time finds the motion of the one before it.
"""

from __future__ import annotations

import numpy as np

MIN_CAMERAS = 4  # cameras at one time that show its shape without help from other times
FRONT = 3  # newest times on either side, or
FRONT_OF_ALL = 0.06  # this share of all times
FRONT_SHARE = 0.5  # of the steps while the window opens


class Curriculum:
    """The frame of each step, from seed and step alone, so that a resumed run sees what it would have seen.

    train [n]: indices of the training frames. time [n] in [0, 1]: theirs. first: steps on the first window. last: step at which all times
    are in. start: times to either side of the middle one that the first window holds. several: one time alone shows the scene
    from several sides. With fewer than `MIN_CAMERAS` frames in the first
    window, or last <= first, every frame is in from the start.
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
        """How many times away from the middle one the frames of this step may lie."""
        if not self.opens:
            return self.farthest
        share = (step - self.first) / (self.last - self.first)
        return int(np.clip(self.start + np.ceil(share * (self.farthest - self.start)), self.start, self.farthest))

    def complete(self, step: int) -> bool:
        """All times have been in for this and all later steps."""
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
        """Up to ``count`` different frames among those that training has reached."""
        eligible = self.train[self.distance <= self.window(step)]
        rng = np.random.default_rng((self.seed, 1, step))
        return [int(i) for i in rng.permutation(eligible)[:count]]
