"""The times of a video's pictures from the time stamps of its packets. Good stamps stay; only bad ones are replaced, between their good
neighbours."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

WRAP = 2**33  # ticks after which the clock of MPEG-TS begins again
MOST_REORDERED = 40  # places by which a picture may be shown later or earlier than it is decoded; H.264 and HEVC allow 16
_LOST = 0.34  # share of missing stamps from which nothing can be placed between the others
_LEAST_GOOD = 0.3  # share of good stamps
_PAUSE = 1.6  # a gap this many times the usual one is where a moved stamp is missing
_NEAR = 5  # places around a doubled stamp in which its own place is looked for
_MOST_PLACED = 200  # stamps whose place is looked for one by one; more of them stay behind the stamp before them
_FALLING = 0.1  # share of falling steps from which pictures are stored in another order, whatever the stream says
_RATE_ERROR = 0.02


@dataclass(frozen=True)
class Times:
    """Pictures in the order in which they are shown. raw: each one's stamp as the file has it, ticks or None. ticks [N] float64: the
    repaired clock. repaired: how many stamps were replaced. jumps: how often the clock began again. untimed: the file has no
    stamps that could be used; `ticks` counts the pictures."""

    raw: tuple[int | None, ...]
    ticks: np.ndarray
    repaired: int = 0
    jumps: int = 0
    untimed: bool = False


def picture_times(stamps: Sequence[int | None], reordered: bool) -> Times:
    """stamps: in the order of the file. reordered: whether pictures may be stored in another order than they are shown in."""
    known = [i for i, stamp in enumerate(stamps) if stamp is not None]
    if len(known) < 2 or len(stamps) - len(known) > _LOST * len(stamps):
        return Times(tuple(stamps), np.arange(len(stamps), dtype=np.float64), untimed=True)
    clock, jumps = _one_clock(stamps)
    steps = np.diff([value for value in clock if value is not None])
    if not reordered and np.mean(steps < 0) < _FALLING:
        order = list(range(len(stamps)))
        values = clock
    else:
        order, values = _shown_order(clock)
    good = _rising(values)
    raw = tuple(stamps[i] for i in order)
    if len(good) < _LEAST_GOOD * len(values):  # such as all alike
        return Times(raw, np.arange(len(stamps), dtype=np.float64), untimed=True)
    return Times(raw, _filled(values, good), len(values) - len(good), jumps)


def frame_rate(seconds: Sequence[float], stated: float | None) -> float | None:
    """Frames per second: the stated rate if it fits the times, else the mean rate; None for one frame with no rate."""
    if len(seconds) < 2 or not seconds[-1] > 0:
        return stated
    mean = (len(seconds) - 1) / seconds[-1]
    return stated if stated and abs(stated / mean - 1) < _RATE_ERROR + 1 / len(seconds) else mean


def _one_clock(stamps: Sequence[int | None]) -> tuple[list[float | None], int]:
    """Stamps whose clock wraps or begins again, continued as one clock. Single wrong stamps stay as they are."""
    known = np.array([s for s in stamps if s is not None], np.float64)
    distinct = np.unique(known)
    usual = float(np.median(np.diff(distinct))) if len(distinct) > 1 else 1.0
    limit = MOST_REORDERED * usual
    candidates = np.flatnonzero(np.diff(known) < -limit) + 1
    # a clock that began again stays behind; after a single wrong stamp the next ones go on
    falls = [k for k in candidates.tolist() if known[k : k + MOST_REORDERED].max() < known[max(0, k - MOST_REORDERED) : k].min() + limit]
    if not len(falls):
        return [None if s is None else float(s) for s in stamps], 0
    shift = np.zeros(len(known))
    for k in falls:
        fall = known[k - 1] - known[k]
        before = known[max(0, k - MOST_REORDERED) : k].max()
        shift[k:] += WRAP if fall > WRAP / 2 else before + usual - known[k : k + 3].min()
    moved = iter(known + shift)
    return [None if s is None else float(next(moved)) for s in stamps], len(falls)


def _shown_order(clock: Sequence[float | None]) -> tuple[list[int], list[float | None]]:
    """(indices into `clock`, their stamps) in the order of the stamps. Stamps that are missing, doubled or far from their place become
    None, at the place near theirs where one is missing."""
    known = [i for i, value in enumerate(clock) if value is not None]
    ranked = sorted(known, key=lambda i: (clock[i], i))
    place = {i: rank for rank, i in enumerate(ranked)}
    lost = {i for i, value in enumerate(clock) if value is None}
    lost |= {i for rank, i in enumerate(known) if abs(place[i] - rank) > MOST_REORDERED}
    order: list[int] = []
    homeless: list[tuple[int, int]] = [(i, i) for i in sorted(lost)]  # near which place, which picture
    for i in ranked:
        if i in lost:
            continue
        if order and clock[order[-1]] == clock[i]:
            homeless.append((len(order) - 1, i))
        else:
            order.append(i)
    values = [clock[i] for i in order]
    usual = float(np.median(np.diff(np.array(values, np.float64)))) if len(values) > 1 else 1.0
    homeless.sort()
    if len(homeless) > _MOST_PLACED:
        keyed = [(float(k), i, clock[i]) for k, i in enumerate(order)] + [(near + 0.5, i, None) for near, i in homeless]
        keyed.sort(key=lambda entry: entry[:2])
        return [i for _, i, _ in keyed], [value for _, _, value in keyed]
    for done, (near, i) in enumerate(homeless):
        at = _gap(values, near + done, usual)
        order.insert(at, i)
        values.insert(at, None)
    return order, values


def _gap(values: Sequence[float | None], middle: int, usual: float) -> int:
    """Where to insert a picture: in the widest gap near `middle` if it is wider than usual, else behind `middle`."""
    best, widest = min(len(values), middle + 1), _PAUSE * usual
    for k in range(max(1, middle - _NEAR), min(len(values), middle + _NEAR)):
        left, right = values[k - 1], values[k]
        if left is not None and right is not None and right - left > widest:
            best, widest = k, right - left
    return best


def _rising(values: Sequence[float | None]) -> list[int]:
    """Indices of the most values that rise strictly: the good ones. Of two equal neighbours the one that leaves more even gaps is good."""
    array = np.array([np.nan if v is None else v for v in values])
    if (np.diff(array) > 0).all():  # False with a NaN
        return list(range(len(values)))
    ends: list[float] = []
    last: list[int] = []
    before = [-1] * len(values)
    for i, value in enumerate(values):
        if value is None:
            continue
        k = bisect_left(ends, value)
        before[i] = last[k - 1] if k else -1
        if k == len(ends):
            ends.append(value)
            last.append(i)
        elif value < ends[k]:
            ends[k], last[k] = value, i
    good, i = [], last[-1]
    while i >= 0:
        good.append(i)
        i = before[i]
    good.reverse()
    return _more_even(values, good)


def _more_even(values: Sequence[float | None], good: list[int]) -> list[int]:
    for k in range(1, len(good) - 1):
        i, (left, right) = good[k], (good[k - 1], good[k + 1])
        twins = [j for j in (i - 1, i + 1) if left < j < right and values[j] == values[i]]

        def unevenness(j: int, left: int = left, right: int = right, i: int = i) -> float:
            a, b = (values[i] - values[left]) / (j - left), (values[right] - values[i]) / (right - j)  # type: ignore[operator]
            return a * a * (j - left) + b * b * (right - j)

        good[k] = min([i, *twins], key=unevenness)
    return good


def _filled(values: Sequence[float | None], good: list[int]) -> np.ndarray:
    """[N] float64: the good values, and the others spread evenly between them or continued at the usual gap."""
    known = np.array([values[i] for i in good], np.float64)
    ticks = np.interp(np.arange(len(values)), good, known)
    usual = float(np.median(np.diff(known) / np.diff(good))) if len(good) > 1 else 1.0
    for i in range(good[0] - 1, -1, -1):
        ticks[i] = ticks[i + 1] - usual
    for i in range(good[-1] + 1, len(values)):
        ticks[i] = ticks[i - 1] + usual
    return ticks
