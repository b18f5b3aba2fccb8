"""When the pictures of a numbered sequence were taken: numbers that are missing between them stand for time that passed."""

from __future__ import annotations

import posixpath
import re
from collections import Counter
from collections.abc import Sequence
from fractions import Fraction
from itertools import pairwise

from ..reading import Shot
from .names import decimal_of

_LEAST_THERE = 0.5  # of the numbers from the first to the last; of more gaps it is not known whether they are pictures that are missing
_FEWEST = 6  # names that have to be random before they are called so
_MOST_TOLD = 3  # gaps
_LAST = (999, 9999)  # numbers after which counters of cameras begin again
SPLIT_WORDS = frozenset({"train", "val", "test", "eval", "validation"})  # in names of folders and pictures, which are no cameras


def places(names: Sequence[str]) -> tuple[list[int], str | None]:
    """The place of each picture on the clock of its sequence, in steps, the first at 0; and a line for people if their numbers do not rise
    evenly. names: in order. Places follow the numbers if these rise by multiples of their commonest step and at least half are there;
    otherwise the pictures are evenly spaced."""
    even = list(range(len(names)))
    numbers = _numbers(names)
    steps = [] if numbers is None else [b - a for a, b in pairwise(numbers)]
    if numbers is None or len(set(steps)) < 2:
        return even, None
    counts = Counter(steps)
    step = min(counts, key=lambda value: (-counts[value], value))
    regular = counts[step] > 1 and min(steps) == step > 0 and not any(s % step for s in steps)
    if not regular or len(numbers) < _LEAST_THERE * ((numbers[-1] - numbers[0]) / step + 1):
        k = max(range(len(steps)), key=lambda i: steps[i])
        if numbers[-1] in _LAST and numbers[0] <= 1 and steps[k] > len(numbers):
            return even, (
                f"the counter of the camera seems to have begun again after {names[-1]}, so {names[k + 1]} to {names[-1]} are taken as the "
                f"last though they were the first: give the pictures from {names[0]} on higher numbers"
            )
        return even, (
            f"the numbers in the names rise unevenly, most from {names[k]} to {names[k + 1]}: the pictures are taken as evenly spaced in "
            "time; use --static if nothing moves"
        )
    gaps = [_gap(a, b, step) for a, b in pairwise(numbers) if b - a > step]
    told = ", ".join(gaps[:_MOST_TOLD]) + (f" and {len(gaps) - _MOST_TOLD} more gaps" if len(gaps) > _MOST_TOLD else "")
    return [int((n - numbers[0]) / step) for n in numbers], (
        f"the names skip {told}: times follow the numbers, as if these pictures were missing; if the pictures are evenly spaced, number "
        "them without gaps"
    )


def give_no_order(names: Sequence[str]) -> bool:
    """Whether hardly two of `names` differ in numbers alone, as random ones (UUIDs) do, so that their order says nothing of time."""
    if len(names) < _FEWEST:
        return False
    stems = [posixpath.splitext(posixpath.basename(name))[0] for name in names]
    return 2 * len({re.sub(r"[0-9]+", "0", stem) for stem in stems}) > len(names)


def grid(names: Sequence[str]) -> tuple[int, int] | None:
    """How many values each of the two numbers in `names` has, if the names differ in just two numbers and hold all combinations of them,
    as those of several cameras at several times do; None otherwise, and for decimal numbers."""
    columns = None if decimal_of(names) is not None else _columns(names)
    if columns is None or len(columns) != 2:
        return None
    first, second = (len(set(column)) for column in columns)
    return (first, second) if len(set(zip(*columns, strict=True))) == len(names) == first * second else None


def two_numbers(names: Sequence[str]) -> list[list[int]] | None:
    """The two numbers in which `names` differ, each [len(names)], if no pair of them occurs twice and at least half of the combinations of
    their values are there; None otherwise."""
    columns = None if decimal_of(names) is not None else _columns(names)
    if columns is None or len(columns) != 2 or len(set(zip(*columns, strict=True))) < len(names):
        return None
    first, second = (len(set(column)) for column in columns)
    return columns if len(names) >= _LEAST_THERE * first * second else None


def words(names: Sequence[str]) -> tuple[list[str], list[int]] | None:
    """The words and the number of each of ``names``, such as `left_` and 12 for `left_0012.png`, if the names differ in words and in a
    number, no two have both, and at least half of the numbers are there with several words; None otherwise, for decimal numbers, and for
    words of splits. Numbers that rise together, as a time and a count, are one: the place in their order."""
    split = [re.split(r"([0-9]+)", posixpath.splitext(name)[0]) for name in names]
    if len({len(parts) for parts in split}) != 1 or decimal_of(names) is not None:
        return None
    texts = ["#".join(parts[::2]) for parts in split]
    if SPLIT_WORDS.intersection(re.findall("[a-z]+", " ".join({*texts}).lower())):
        return None
    columns = zip(*([int(number) for number in parts[1::2]] for parts in split), strict=True)
    differing = [column for column in columns if len(set(column)) > 1]
    found = list(zip(*differing, strict=True))
    distinct, kinds = sorted(set(found)), len(set(texts))
    if not 1 < kinds < len(names) or not differing or any(len(set(column)) < len(distinct) for column in differing):
        return None
    shared = sum(count > 1 for count in Counter(found).values())
    if len(set(zip(texts, found, strict=True))) < len(names) or shared < _LEAST_THERE * len(distinct):
        return None
    place = {numbers: i for i, numbers in enumerate(distinct)}
    return texts, list(differing[0]) if len(differing) == 1 else [place[numbers] for numbers in found]


def follow_numbers(shots: Sequence[Shot]) -> tuple[str, ...]:
    """Sets the times of ``shots`` of one camera, in order, by the numbers in the names of their files: structure from motion drops frames.
    Returns a line for people where numbers are missing or say nothing."""
    clock, told = places([shot.file or shot.name for shot in shots])
    set_times(shots, clock, clock[-1] >= len(clock))
    return (told,) if told else ()


def set_times(shots: Sequence[Shot], clock: Sequence[int], gaps: bool) -> None:
    """Sets `Shot.time` of each of ``shots`` to its place on the ``clock``, and `Shot.step` if there are ``gaps``: places without a
    picture, whose time has passed, too."""
    for shot, at in zip(shots, clock, strict=True):
        shot.time = float(at)
        shot.step = at if gaps else None


def _gap(before: Fraction, after: Fraction, step: Fraction) -> str:
    first, last = before + step, after - step
    return _text(first) if first == last else f"{_text(first)} to {_text(last)}"


def _text(value: Fraction) -> str:
    return str(value.numerator) if value.denominator == 1 else f"{float(value):g}"


def _numbers(names: Sequence[str]) -> list[Fraction] | None:
    """The one number in which the names differ; None if they differ in more than one, or in other parts."""
    decimals = decimal_of(names)
    if decimals is not None:
        return decimals
    columns = _columns(names)
    return [Fraction(number) for number in columns[0]] if columns is not None and len(columns) == 1 else None


def _columns(names: Sequence[str]) -> list[list[int]] | None:
    """The numbers at each place of the names where these differ; None if the names differ in other parts."""
    split = [re.split(r"([0-9]+)", posixpath.splitext(name)[0]) for name in names]
    if len({tuple(parts[::2]) for parts in split}) != 1:
        return None
    columns = [[int(text) for text in column] for column in list(zip(*split, strict=True))[1::2]]
    return [column for column in columns if len(set(column)) > 1]
