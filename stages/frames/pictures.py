"""Checks image and mask files by decoding each one once. They are not copied."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from threading import Lock
from typing import Any

from ...pipeline import Context, thread_count
from ...vision.images.colour_profile import conversion_of
from ...vision.images.files import open_image
from ...vision.images.pictures import holds_truth_values, read_keep, read_mask, read_picture
from ..captures import Capture
from ..captures.checks import image_header

DECODE_THREADS = 4  # at most
LARGE = 40_000_000  # px; larger pictures are decoded one at a time, since one of this size takes half a gigabyte, the largest 2 GB


def check_pictures(capture: Capture, ctx: Context) -> None:
    """Decodes every picture and mask once, so that a truncated file is found now and not hours later during training."""
    jobs: list[tuple[str, Callable[..., Any]]] = [(name, read_picture) for name in dict.fromkeys(capture.images or ())]
    jobs += [(name, read_mask) for name in dict.fromkeys(m for m in capture.masks or () if m)]
    jobs += [(name, read_keep) for name in dict.fromkeys(m for m in capture.keeps or () if m)]

    one_at_a_time = Lock()

    def decode(job: tuple[str, Any]) -> str:
        name, read = job
        width, height, _ = image_header(capture.root, name)
        with one_at_a_time if width * height > LARGE else nullcontext():
            read(capture.root, name)
        return name

    with ctx.progress(len(jobs), "check pictures") as progress, ThreadPoolExecutor(thread_count(DECODE_THREADS)) as pool:
        for name in pool.map(decode, jobs):
            progress.advance(1, name)
    masks = [name for name, read in jobs if read is not read_picture and holds_truth_values(capture.root, name)]
    if masks:
        ctx.log(f"{len(masks)} masks hold only 0 and 1, for example {masks[0]}: 1 is taken for white")
    say_profiles(capture, ctx)


def say_profiles(capture: Capture, ctx: Context) -> None:
    """Logs which colour profiles the pictures have, if these are not sRGB."""
    found = Counter[tuple[str, bool]]()
    for name in dict.fromkeys(capture.images or ()):
        with open_image(capture.root / name) as image:
            conversion = conversion_of(image)
        if conversion is not None:
            found[conversion.name, conversion.transform is not None] += 1
    for (name, converted), count in found.items():
        what = "colours are converted from" if converted else "colours are taken as sRGB, in spite of"
        ctx.log(f"{count} of {len(capture.images or ())} pictures: {what} {name}{' to sRGB' if converted else ''}")
