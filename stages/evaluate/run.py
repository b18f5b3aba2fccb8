"""The work of `evaluate`: measures the model's renders against the captured pictures, and collects pictures for the report."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

from ...pipeline import Context, StageError, thread_count
from ..coarse.artifact import steps_of
from ..flow.artifact import flow_of
from ..shared.clocks import clock_lines
from ..shared.model import read_model
from ..shared.posed_frameset import PosedFrameSet
from .artifact import write_metrics
from .flicker import measure_flicker
from .judge import Judge
from .pictures.book import PictureBook
from .pictures.flow import add_flow
from .pictures.movies import write_movies
from .player import write_scene
from .protocol import load_lpips, protocol
from .spread import SAMPLE, most_measured, spread, worst_and_others
from .views import choose_views, time_strip

PICTURE_SIZE = 640  # px, longest side of the report's pictures of views
METRICS = (
    *("psnr", "ssim", "edge_psnr", "lpips", "psnr_affine", "ssim_affine"),
    *("psnr_moving", "psnr_static", "psnr_foreground", "psnr_other_background"),
)


def evaluate(ctx: Context) -> None:
    """Measures the model of `fine`, or that of `coarse` if `fine` was skipped."""
    artifact = ctx.inputs["fine"] if ctx.inputs["fine"] is not None else ctx.inputs["coarse"]
    if artifact is None:
        raise StageError("there is no trained model: both coarse and fine were skipped; run the stage coarse first")
    frames = PosedFrameSet(ctx.inputs["frames"], ctx.capture.root, ctx.inputs["poses"])  # type: ignore[arg-type]
    model = read_model(artifact).to(ctx.device)
    most = most_measured(ctx.settings.measured, steps_of(ctx.inputs["coarse"]))
    views, notes = choose_views(frames, ctx.settings.splits, most)
    notes = [*notes, *clock_lines(model.clocks, frames)]
    for note in notes:
        ctx.log(note)
    lpips, lpips_facts = load_lpips(ctx.settings, frames)
    book = PictureBook(PICTURE_SIZE)
    judge = Judge(model, frames, lpips, fixed=frames.fixed_cameras)
    splits: dict[str, Any] = {}
    sample = {} if "train" in views else {"train": spread([int(i) for i in frames.train], SAMPLE)}
    total = sum(map(len, [*views.values(), *sample.values()]))
    with ctx.progress(total, "views") as bar, ThreadPoolExecutor(thread_count()) as pool:
        for split, indices in (sample | views).items():
            rows = []
            for row in measured_rows(judge, indices, pool):
                rows.append(row)
                bar.advance(1, f"{row['psnr']:.1f} dB")
            known = {row["frame"]: row for row in rows}
            for i in worst_and_others(rows, ctx.settings.max_views) if split in views else ():
                truth, (_, frame) = frames.composited(i), judge.render(i)
                book.add_view(split, frames.names[i], float(frames.time[i]), truth, frame, known[i], judge.kept(i))
            splits[split] = {**means(rows), **lpips_facts, "frames": len(rows), "per_view": rows}
            if lpips is not None:
                splits[split].pop("lpips_reason", None)
    book.add_strip(*time_strip(judge, frames, next(reversed(views.values()))))
    if (flow := flow_of(ctx.inputs)) is not None:
        add_flow(book, judge, flow, ctx.settings.max_views)
    book.stored.write(ctx.out)
    write_movies(ctx, judge, frames, next(reversed(views.values())), ctx.settings.movie_frames)
    if ctx.settings.player and (reason := write_scene(ctx.out, judge, frames)) is not None:
        ctx.log(f"the report does not play the scene: {reason}; e4dgs export web CAPTURE writes a page of any size")
    metrics = {
        "protocol": protocol(frames, sample | views, ctx.settings, lpips_facts, notes),
        "splits": splits,
        "primitives": {"gaussians": len(model.gaussians), "convexes": len(model.convexes)},
        "flicker": measure_flicker(judge, frames, most, ctx.progress),
    }
    write_metrics(ctx.out, metrics, {"render_fps": judge.frames_per_second(next(reversed(views.values())))})


def measured_rows(judge: Judge, indices: Sequence[int], pool: ThreadPoolExecutor) -> Iterator[dict[str, Any]]:
    """Rows of metrics of the views ``indices``, in their order. Metrics use one core each, so ``pool`` measures a few views while this
    thread renders the next."""
    waiting: deque[Future[dict[str, Any]]] = deque()
    for i in indices:
        waiting.append(pool.submit(judge.measured, i, *judge.render(i)))
        if len(waiting) > thread_count():
            yield waiting.popleft().result()
    while waiting:
        yield waiting.popleft().result()


def means(rows: Sequence[Mapping[str, Any]]) -> dict[str, float | None]:
    """Mean of each metric over the views that have it; None if no view has it."""
    result: dict[str, float | None] = {}
    for name in METRICS:
        if name in rows[0]:
            values = [float(row[name]) for row in rows if row[name] is not None]
            result[name] = sum(values) / len(values) if values else None
    return result
