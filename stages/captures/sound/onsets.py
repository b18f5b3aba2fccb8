"""Aligns the clocks of several recordings of one event by their sound."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ....pipeline import CaptureError
from ..video.tracks import best_track
from ..video_files import open_video

RATE = 8000  # samples per second used for the analysis
HOP, WINDOW = 32, 128  # samples: one value of the envelope every 4 ms, each from 16 ms
LONGEST = 1200.0  # s of sound that are analysed at most
LOCAL = 0.5  # s, window of the moving average that is subtracted as background
LOUDEST = 6.0  # standard deviations at which a single onset is clipped, so that one loud bang does not determine the result
LEAST_OVERLAP = 0.5  # s
LEAST_PEAK = 8.0  # standard deviations of the correlation of unrelated sounds
CLEAR = 1.4  # times the next highest peak; music repeats itself and fits almost as well a beat later
APART = 0.06  # s; closer values belong to the same peak


def onsets(root: Path, name: str) -> tuple[np.ndarray, float] | None:
    """Onset strength of the sound over time: `(envelope, start)`, envelope [N] float64 with mean 0 and standard deviation 1, one value
    every 4 ms, the first at `start` seconds after the video's first picture. None if there is no decodable sound, or only silence."""
    heard = _samples(root, name)
    if heard is None or len(heard[0]) < WINDOW + RATE * LEAST_OVERLAP:
        return None
    samples, start = heard
    windows = np.lib.stride_tricks.sliding_window_view(samples, WINDOW)[::HOP]
    taper = np.hanning(WINDOW).astype(np.float32)
    loudness = np.empty((len(windows), WINDOW // 2 + 1), np.float32)
    for k in range(0, len(windows), 8192):
        loudness[k : k + 8192] = np.abs(np.fft.rfft(windows[k : k + 8192] * taper, axis=1))
    level = float(loudness.mean())
    if not level > 1e-7:
        return None
    rising = np.maximum(np.diff(np.log1p(10.0 * loudness / level), axis=0), 0.0).mean(axis=1).astype(np.float64)
    width = round(LOCAL * RATE / HOP)
    rising -= np.convolve(rising, np.full(width, 1 / width), "same")
    deviation = float(rising.std())
    if not deviation > 0:
        return None
    clipped = np.clip(rising / deviation, -LOUDEST, LOUDEST)
    # an onset is the difference of two windows, so its time is halfway between their centres
    return (clipped - clipped.mean()) / clipped.std(), start + 0.5 * (WINDOW + HOP) / RATE


def offset(first: tuple[np.ndarray, float], second: tuple[np.ndarray, float]) -> float | None:
    """Seconds to add to the second recording's times to bring them to the first one's clock; None if no shift stands out.

    first, second: results of `onsets`. The correlation at every shift is divided by the square root of the overlap, so for unrelated sounds
    it has standard deviation 1 at any shift.
    """
    a, b = first[0], second[0]
    size = 1 << (len(a) + len(b)).bit_length()
    product = np.fft.irfft(np.fft.rfft(a, size) * np.conj(np.fft.rfft(b, size)), size)
    shifts = np.arange(-(len(b) - 1), len(a))
    overlap = np.minimum(len(a), shifts + len(b)) - np.maximum(0, shifts)
    score = np.where(overlap >= LEAST_OVERLAP * RATE / HOP, product[shifts] / np.sqrt(np.maximum(overlap, 1)), -np.inf)
    best = int(score.argmax())
    away = np.abs(shifts - shifts[best]) > APART * RATE / HOP
    rival = float(score[away].max(initial=1.0))
    if score[best] < LEAST_PEAK or score[best] < CLEAR * rival:
        return None
    return float(shifts[best]) * HOP / RATE + first[1] - second[1]


def _samples(root: Path, name: str) -> tuple[np.ndarray, float] | None:
    """The first audio track as float32 [N], mono at `RATE`, and its start in seconds after the first picture; None if it cannot be
    decoded."""
    import av

    pieces: list[np.ndarray] = []
    start = None
    try:
        with open_video(root, name) as container:
            if not container.streams.audio:
                return None
            stream, picture = container.streams.audio[0], best_track(container, name)
            begin = float((picture.start_time or 0) * (picture.time_base or 0))
            resampler = av.AudioResampler(format="flt", layout="mono", rate=RATE)
            count = 0
            for frame in container.decode(stream):
                if start is None:
                    start = (frame.time or 0.0) - begin
                for part in resampler.resample(frame):
                    pieces.append(part.to_ndarray().reshape(-1))
                    count += len(pieces[-1])
                if count > LONGEST * RATE:
                    break
            else:
                pieces += [part.to_ndarray().reshape(-1) for part in resampler.resample(None)]
    except (av.FFmpegError, OSError, ValueError, IndexError, CaptureError):
        return None  # the pictures can be used without sound
    return (np.concatenate(pieces), start) if pieces and start is not None else None
