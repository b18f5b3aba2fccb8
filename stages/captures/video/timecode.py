"""The clocks of cameras from the timecode that each wrote into its video (SMPTE ST 12-1), as cameras with a common clock do."""

from __future__ import annotations

import re
from collections.abc import Sequence

MOST_RATE = 60.5  # frames per second; faster cameras count several pictures as one frame, and how many is not written
DAY = 86_400  # seconds of the code, after which it begins again
SAME = 1e-4  # s; codes whose seconds differ by more in length drift apart
_CODE = re.compile(r"(\d\d):([0-5]\d):([0-5]\d)([:;.])(\d\d)")


def seconds_of(code: str, fps: float) -> tuple[float, float] | None:
    """Seconds from midnight to the first frame, and how many seconds pass while the code counts one; None if `code` is no timecode of
    this rate. Codes at 29.97 frames per second count 30 frames as a second, so theirs is 0.1 % longer. A semicolon or a full stop before
    the frames marks drop-frame codes, which keep up with the clock: they leave out two numbers (four at 59.94) in nine of ten minutes."""
    found, nominal = _CODE.fullmatch(code.strip()), round(fps)
    if found is None or not 1 <= fps <= MOST_RATE:
        return None
    hours, minutes, seconds, frames = (int(found[k]) for k in (1, 2, 3, 5))
    if hours > 23 or frames >= nominal:
        return None
    count = (3600 * hours + 60 * minutes + seconds) * nominal + frames
    if found[4] != ":" and nominal in (30, 60):
        passed = 60 * hours + minutes
        return (count - nominal // 15 * (passed - passed // 10)) / fps, 1.0
    return count / fps, nominal / fps


def shifts(codes: Sequence[str | None], rates: Sequence[float | None], lengths: Sequence[float]) -> list[float] | None:
    """Seconds to add to each video's own times to bring them to the first one's clock. None unless all have a timecode, count seconds of
    one length, and overlap in time.

    codes, rates, lengths: timecode of the first frame, frames per second and seconds of each video.
    """
    shifted = _shifted(codes, rates)
    if shifted is None or _end(shifted, lengths)[1] <= max(shifted):
        return None
    return shifted


def apart(codes: Sequence[str | None], rates: Sequence[float | None], lengths: Sequence[float]) -> tuple[int, int] | None:
    """The numbers of two videos of which the second begins when the first has ended: the first to end and the last to begin. None unless
    all codes are known and there are such. The arguments are those of `shifts`."""
    shifted = _shifted(codes, rates)
    if shifted is None:
        return None
    ended, end = _end(shifted, lengths)
    begun = max(range(len(shifted)), key=shifted.__getitem__)
    return (ended, begun) if end <= shifted[begun] else None


def _end(shifted: Sequence[float], lengths: Sequence[float]) -> tuple[int, float]:
    """The video that ends first, and when."""
    ends = [shift + length for shift, length in zip(shifted, lengths, strict=True)]
    return min(enumerate(ends), key=lambda end: end[1])


def _shifted(codes: Sequence[str | None], rates: Sequence[float | None]) -> list[float] | None:
    """Seconds by which each video begins after the first one; None unless all codes are known and count seconds of one length."""
    found = [seconds_of(code, rate) for code, rate in zip(codes, rates, strict=True) if code is not None and rate is not None]
    known = [one for one in found if one is not None]
    if len(known) < len(codes) or max(second for _, second in known) - min(second for _, second in known) > SAME:
        return None
    day = DAY * known[0][1]
    return [(begin - known[0][0] + day / 2) % day - day / 2 for begin, _ in known]
