"""The movies of an evaluation: held-out views next to their ground truth in order of time, and a turntable around the scene."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
import torch

from ....pipeline import ArtifactWriter, Context
from ....pipeline.choice.evenly import evenly
from ....rasterizer import Camera
from ....vision.images.movie import encode_movie
from ....vision.images.pictures import shrunk
from ...exports.camera_path import named_path
from ...shared.posed_frameset import PosedFrameSet
from ..artifact import write_movie
from ..judge import Judge
from .book import to_bytes

SIZE = 480  # px, longest side of one picture
SECONDS, FPS = 4.0, (2.0, 30.0)  # desired duration, and bounds on the frames per second, which take precedence
QUALITY = 23  # constant rate factor of x264
LEAST = 3  # least number of pictures of a movie


def write_movies(ctx: Context, judge: Judge, frames: PosedFrameSet, indices: Sequence[int], most: int) -> None:
    """Writes "over_time", if ``indices`` have several times, and "turntable": MP4 files of at most ``most`` pictures."""
    mine = in_order_of_time(frames, indices, most)
    turned = most if most >= LEAST else 0
    with ctx.progress(len(mine) + turned, "movies") as bar:
        if len(mine) >= LEAST:
            doc = "held-out views beside their truth, in order of time"
            _write(ctx.out, "over_time", (_beside(judge, frames, i) for i in mine), len(mine), doc, bar.advance)
        if turned:
            doc = "a turn about the scene while time goes by once"
            _write(ctx.out, "turntable", _turn(judge, frames, turned), turned, doc, bar.advance)


def in_order_of_time(frames: PosedFrameSet, indices: Sequence[int], most: int) -> list[int]:
    """Up to ``most`` of ``indices`` with increasing times: from the camera that has most of them, or from all if no camera has at least
    `LEAST`. Empty if they have only one time."""
    number, counts = np.unique(frames.camera[list(indices)], return_counts=True)
    chosen = [i for i in indices if counts.max() < LEAST or frames.camera[i] == number[counts.argmax()]]
    _, first = np.unique(frames.time[chosen], return_index=True)
    if len(first) < 2 or most < LEAST:
        return []
    ordered = [chosen[k] for k in first]
    return evenly(ordered, most)


def _beside(judge: Judge, frames: PosedFrameSet, i: int) -> np.ndarray:
    """The ground truth on the left, the render on the right."""
    return np.concatenate([shrunk(frames.composited(i), SIZE), shrunk(to_bytes(judge.render(i)[0]), SIZE)], axis=1)


def _turn(judge: Judge, frames: PosedFrameSet, count: int) -> Iterator[np.ndarray]:
    way = named_path("turntable", frames, judge.model, count)
    scale = min(1.0, SIZE / max(frames.width, frames.height))
    width, height = max(round(scale * frames.width), 2), max(round(scale * frames.height), 2)
    size = np.diag([width / frames.width, height / frames.height, 1.0])
    for K, pose, time in zip(way.K, way.cam_from_world, way.time):
        camera = Camera(torch.tensor(size @ K).float(), torch.tensor(pose).float(), width, height, judge.model.near)
        yield to_bytes(judge.model.render(camera, float(time)).color.cpu().numpy())


def _write(out: ArtifactWriter, name: str, pictures: Iterator[np.ndarray], count: int, doc: str, made: Callable[[int], object]) -> None:
    def counted() -> Iterator[np.ndarray]:
        for picture in pictures:
            yield picture
            made(1)

    data = encode_movie(counted(), float(np.clip(count / SECONDS, *FPS)), QUALITY)
    write_movie(out, name, data, doc)
