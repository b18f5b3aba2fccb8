"""Checks image and mask files by decoding each one once. They are not copied."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from threading import Lock
from typing import Any

import numpy as np

from ...pipeline import Context, thread_count
from ...vision.images.film import Film, small
from ...vision.images.pictures import read_keep, read_mask, read_picture
from ..captures import Capture
from ..captures.checks import image_header
from ..facts import Facts
from .odd_frames import told as told_odd

DECODE_THREADS = 4  # at most
_SOME = (  # only a sample is looked at before
    "transparent pixels show the colours stored in them, because the pictures that were judged are opaque; paint over them, or mark them "
    "black in masks"
)
LARGE = 40_000_000  # px; larger pictures are decoded one at a time, since one of this size takes half a gigabyte, the largest 2 GB


def check_pictures(capture: Capture, ctx: Context) -> None:
    """Decodes every picture and mask once, so that a truncated file is found now and not hours later during training. Logs which pictures
    of one camera over time are no new moments of one scene."""
    jobs: list[tuple[str, Callable[..., Any]]] = [(name, read_picture) for name in dict.fromkeys(capture.images or ())]
    jobs += [(name, read_mask) for name in dict.fromkeys(m for m in capture.masks or () if m)]
    jobs += [(name, read_keep) for name in dict.fromkeys(m for m in capture.keeps or () if m)]

    one_at_a_time, said = Lock(), Counter[tuple[str, str]]()
    facts, film = Facts.of(capture.facts), Film()
    is_film = facts.cameras == 1 and not facts.static and capture.cam_from_world is None  # files with poses chose their pictures

    def decode(job: tuple[str, Any]) -> tuple[str, list[tuple[str, str]], np.ndarray | None]:
        (name, read), told = job, list[tuple[str, str]]()
        width, height, _ = image_header(capture.root, name)
        with one_at_a_time if width * height > LARGE else nullcontext():
            found = read(capture.root, name, say=lambda what: told.append(("picture" if read is read_picture else "mask", what)))
        if read is read_picture and not facts.alpha and found.shape[2] == 4 and found[..., 3].min() < 255:
            told.append(("picture", _SOME))
        return name, told, small(found) if is_film and read is read_picture else None

    with ctx.progress(len(jobs), "check pictures") as progress, ThreadPoolExecutor(thread_count(DECODE_THREADS)) as pool:
        for name, told, picture in pool.map(decode, jobs):
            said.update(told)
            if picture is not None:
                film.add(picture)
            progress.advance(1, name)
    for (kind, what), count in said.items():
        ctx.log(f"{what} ({count} {kind}{'s' if count != 1 else ''})")
    for line in told_odd({"": (film, capture.names)}):
        ctx.log(line)
