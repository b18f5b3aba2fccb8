"""The moving pictures of an evaluation: held-out views in order of time beside their truth, and a turn about the scene."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import torch

from ...pipeline import ArtifactWriter
from ...rasterizer import Camera
from ...vision.images.movie import encode_movie
from ..artifacts.evaluate import write_movie
from ..artifacts.frameset import FrameSet
from ..exports.camera_path import named_path
from .judge import Judge
from .pictures import scaled, to_bytes

SIZE = 480  # px, longest side of one picture
SECONDS, FPS = 4.0, (2.0, 30.0)  # how long it takes, as far as its pictures a second stay in these bounds
QUALITY = 23  # of x264, constant rate factor
LEAST = 3  # pictures without which nothing moves


def write_movies(out: ArtifactWriter, judge: Judge, frames: FrameSet, indices: Sequence[int], most: int) -> None:
    """ "over_time", where ``indices`` have several times, and "turntable": MP4 files of at most ``most`` pictures."""
    mine = in_order_of_time(frames, indices, most)
    if len(mine) >= LEAST:
        _write(
            out, "over_time", (_beside(judge, frames, i) for i in mine), len(mine), "held-out views beside their truth, in order of time"
        )
    if most >= LEAST:
        _write(out, "turntable", _turn(judge, frames, most), most, "a turn about the scene while time goes by once")


def in_order_of_time(frames: FrameSet, indices: Sequence[int], most: int) -> list[int]:
    """Up to ``most`` of ``indices`` with rising times: of the camera that saw most of them, or of all where no camera saw several.
    Empty where they have one time."""
    number, counts = np.unique(frames.camera[list(indices)], return_counts=True)
    chosen = [i for i in indices if counts.max() < LEAST or frames.camera[i] == number[counts.argmax()]]
    _, first = np.unique(frames.time[chosen], return_index=True)
    if len(first) < 2 or most < LEAST:
        return []
    ordered = [chosen[k] for k in first]
    return [ordered[round(k)] for k in np.linspace(0, len(ordered) - 1, min(most, len(ordered)))]


def _beside(judge: Judge, frames: FrameSet, i: int) -> np.ndarray:
    """Truth on the left, render on the right."""
    return np.concatenate([scaled(frames.composited(i), SIZE), scaled(to_bytes(judge.render(i)[0]), SIZE)], axis=1)


def _turn(judge: Judge, frames: FrameSet, count: int) -> Iterator[np.ndarray]:
    way = named_path("turntable", frames, judge.model, count)
    scale = min(1.0, SIZE / max(frames.width, frames.height))
    width, height = max(round(scale * frames.width), 2), max(round(scale * frames.height), 2)
    size = np.diag([width / frames.width, height / frames.height, 1.0])
    for K, pose, time in zip(way.K, way.cam_from_world, way.time):
        camera = Camera(torch.tensor(size @ K).float(), torch.tensor(pose).float(), width, height, judge.model.near)
        yield to_bytes(judge.model.render(camera, float(time)).color.cpu().numpy())


def _write(out: ArtifactWriter, name: str, pictures: Iterator[np.ndarray], count: int, doc: str) -> None:
    data = encode_movie(pictures, float(np.clip(count / SECONDS, *FPS)), QUALITY)
    write_movie(out, name, data, doc)
