"""Stage `evaluate`: metrics of held-out views against the capture's own pictures, frames per second, and pictures for the report.

Renders are clamped to [0, 1] and compared as floats, not quantised. Ground truth is the frame on the capture's background, 8 bits,
undistorted. Frames without a pose are counted and left out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from pydantic import Field

from ..pipeline import Applies, Context, Resources, Settings, Stage, StageError
from .evaluation.spread import spread, worst_and_others

if TYPE_CHECKING:
    import numpy as np

    from ..scene.metrics.lpips import Lpips
    from .artifacts.frameset import FrameSet
    from .evaluation.judge import Judge

Split = Literal["train", "val", "test"]
METRICS = (
    *("psnr", "ssim", "edge_psnr", "lpips", "psnr_affine", "ssim_affine"),
    *("psnr_moving", "psnr_static", "psnr_foreground", "psnr_other_background"),
)
TRAIN_VIEWS = 32  # where nothing is held out, so many training views stand in
SAMPLE = 16  # training views beside the held-out ones: far better ones mean a model that has learned views, not the scene


class EvaluateSettings(Settings):
    splits: tuple[Split, ...] = Field(("val", "test"), min_length=1, description="splits to measure, by commas")
    max_views: int = Field(8, ge=0, le=1000, description="views of each split shown in the report, half of them the worst")
    movie_frames: int = Field(60, ge=0, le=1000, description="pictures of each of the report's two movies; 0: none")
    picture_size: int = Field(640, ge=16, le=8192, description="px; longest side of the report's pictures")
    lpips_weights: Path | None = Field(None, description="safetensors file with the network's weights; LPIPS is measured only with it")
    lpips_net: Literal["alex", "vgg"] = Field("alex", description="network of lpips_weights")


class Evaluate(Stage):
    """PSNR, SSIM, PSNR near edges, LPIPS of every held-out view, and of some training views beside them.

    Measured is the model of `fine`, or of `coarse` where `fine` was skipped.
    """

    name = "evaluate"
    inputs = ("frames", "poses", "flow", "coarse", "fine")
    settings = EvaluateSettings
    reads_capture = True
    device_class = True

    def applies(self, facts: Mapping[str, Any], settings: EvaluateSettings) -> Applies:
        counts = facts.get("splits", {})
        chosen = [f"{counts[split]} {split} views" for split in settings.splits if counts.get(split)]
        if chosen:
            return Applies.yes(", ".join(chosen))
        return Applies.yes(f"no views in {', '.join(settings.splits)}: training views are measured instead")

    def estimate(self, facts: Mapping[str, Any], settings: EvaluateSettings) -> float | None:
        """Two cores: about 1.2 s a view and megapixel for render and metrics, without LPIPS."""
        counts = facts.get("splits", {})
        views = SAMPLE + sum(int(counts.get(split, 0)) for split in settings.splits)
        return 3.0 + 1.2 * views * facts["width"] * facts["height"] / 1e6

    def resources(self, facts: Mapping[str, Any], settings: EvaluateSettings, device: str) -> Resources:
        from .estimates import training_resources

        return training_resources(facts, device)

    def run(self, ctx: Context) -> None:
        from .artifacts.frameset import FrameSet
        from .artifacts.training import read_model
        from .evaluation.flicker import measure_flicker
        from .evaluation.flow_pictures import add_flow
        from .evaluation.judge import Judge
        from .evaluation.movies import write_movies
        from .evaluation.pictures import PictureBook

        artifact = ctx.inputs["fine"] if ctx.inputs["fine"] is not None else ctx.inputs["coarse"]
        if artifact is None:
            raise StageError("there is no trained model: both coarse and fine were skipped; set coarse.iterations above 0")
        frames = FrameSet(ctx.inputs["frames"], ctx.capture.root, ctx.inputs["poses"])  # type: ignore[arg-type]
        model = read_model(artifact).to(ctx.device)
        views, notes = choose_views(frames, ctx.settings.splits)
        for note in notes:
            ctx.log(note)
        lpips, lpips_facts = load_lpips(ctx.settings, frames)
        book = PictureBook(ctx.settings.picture_size)
        judge = Judge(model, frames, lpips, fixed=frames.fixed_cameras)
        splits: dict[str, Any] = {}
        sample = {} if "train" in views else {"train": spread([int(i) for i in frames.train], SAMPLE)}
        with ctx.progress(sum(map(len, [*views.values(), *sample.values()])), "views") as bar:
            for split, indices in (sample | views).items():
                rows = []
                for i in indices:
                    rows.append(judge.view(i)[0])
                    bar.advance(1, f"{rows[-1]['psnr']:.1f} dB")
                for i in worst_and_others(rows, ctx.settings.max_views) if split in views else ():
                    row, frame, truth = judge.view(i)
                    book.add_view(split, frames.names[i], float(frames.time[i]), truth, frame, row)
                splits[split] = {**means(rows), **lpips_facts, "frames": len(rows), "per_view": rows}
                if lpips is not None:
                    splits[split].pop("lpips_reason", None)
        book.add_strip(*time_strip(judge, frames, next(reversed(views.values()))))
        if ctx.inputs["flow"] is not None:
            add_flow(book, judge, ctx.inputs["flow"], ctx.settings.max_views)
        book.write(ctx.out)
        write_movies(ctx.out, judge, frames, next(reversed(views.values())), ctx.settings.movie_frames)
        ctx.out.attrs["metrics"] = {
            "protocol": protocol(frames, sample | views, ctx.settings, lpips_facts, notes),
            "splits": splits,
            "primitives": {"gaussians": len(model.gaussians), "convexes": len(model.convexes)},
            "flicker": measure_flicker(judge, frames),
        }
        ctx.out.info["metrics"] = {"render_fps": judge.frames_per_second(next(reversed(views.values())))}


def choose_views(frames: FrameSet, splits: Sequence[str]) -> tuple[dict[str, list[int]], list[str]]:
    """Frames with a pose of each split, in the order of ``splits``, and sentences about what is missing.

    Where no split has any, training views stand in. Raises StageError where no frame has a pose.
    """
    import numpy as np

    views: dict[str, list[int]] = {}
    notes = []
    for number, split in enumerate(("train", "val", "test")):
        total = int((frames.split == number).sum())
        posed = [int(i) for i in np.flatnonzero((frames.split == number) & frames.registered)]
        if split not in splits:
            continue
        if posed:
            views[split] = posed
        if len(posed) < total:
            notes.append(f"{total - len(posed)} of {total} {split} frames have no pose and are not measured")
    if not views:
        posed = [int(i) for i in np.flatnonzero((frames.split == 0) & frames.registered)]
        if not posed:
            raise StageError("no frame has a pose, so there is no view to measure; see the coverage report of `poses`")
        views["train"] = spread(posed, TRAIN_VIEWS)
        notes.append(
            f"no {' or '.join(splits)} views: {len(views['train'])} of {len(posed)} training views are measured, "
            "which says nothing about new views; hold some out with --set frames.holdout=8"
        )
    return views, notes


def means(rows: Sequence[Mapping[str, Any]]) -> dict[str, float | None]:
    """Mean of each metric over the views that have it; None where no view does."""
    result: dict[str, float | None] = {}
    for name in METRICS:
        if name in rows[0]:
            values = [float(row[name]) for row in rows if row[name] is not None]
            result[name] = sum(values) / len(values) if values else None
    return result


def load_lpips(settings: EvaluateSettings, frames: FrameSet) -> tuple[Lpips | None, dict[str, str]]:
    """The network, or None with `lpips_reason`. Raises StageError where the weights file is not one."""
    if settings.lpips_weights is None:
        return None, {"lpips_reason": "no weights given; --set evaluate.lpips_weights=FILE measures it"}
    from ..scene.metrics.lpips import MINIMUM_SIZE, Lpips

    if min(frames.width, frames.height) < MINIMUM_SIZE:
        return None, {"lpips_reason": f"pictures of {frames.width}x{frames.height} are smaller than the {MINIMUM_SIZE} px that LPIPS needs"}
    try:
        return Lpips.load(settings.lpips_weights, settings.lpips_net), {}
    except ValueError as error:
        raise StageError(f"evaluate.lpips_weights: {error}") from error


def protocol(
    frames: FrameSet, views: Mapping[str, Sequence[int]], settings: EvaluateSettings, lpips_facts: Mapping[str, str], notes: Sequence[str]
) -> dict[str, Any]:
    """Everything that a number needs beside it to be compared with another."""
    measured = not lpips_facts
    result: dict[str, Any] = {
        "resolution": f"{frames.width}x{frames.height}",
        "split": ", ".join(f"{split} ({len(indices)} views)" for split, indices in views.items()),
        "background": frames.background,
        "lpips_net": settings.lpips_net if measured else None,
        "colours": "of the mean training camera; psnr_affine after one affine a channel and view",
        "moving": "of fixed cameras: pixels within 2 px of one that is more than 0.1 from the camera's median over time",
        "metrics": "float64 on clamped float renders; SSIM 11x11 Gaussian, sigma 1.5, zero padding; edges: Canny 50/100, within 2 px",
        "flicker": "fixed cameras, neighbouring times; excess change of the render, in levels of 8 bits; flow: tOF in px",
        "notes": list(notes),
    }
    if measured and settings.lpips_weights is not None:
        from blake3 import blake3

        result["lpips_weights_blake3"] = blake3(Path(settings.lpips_weights).read_bytes()).hexdigest()
    return result


def time_strip(judge: Judge, frames: FrameSet, indices: Sequence[int]) -> tuple[str, list[tuple[float, np.ndarray, np.ndarray | None]]]:
    """One camera over time: its name and up to eight (time, render float32 [H, W, 3], ground truth uint8 or None).

    A camera that saw several times of the split is followed through them; else the first view's camera stands still in time.
    """
    import numpy as np

    first = indices[0]
    mine = sorted((i for i in indices if frames.camera[i] == frames.camera[first]), key=lambda i: float(frames.time[i]))
    assert frames.cam_from_world is not None
    fixed = all(np.allclose(frames.cam_from_world[i], frames.cam_from_world[first], atol=1e-6) for i in mine)
    if fixed and len(mine) >= 3:
        return frames.names[first], [(float(frames.time[i]), judge.render(i)[0], frames.composited(i)) for i in spread(mine, 8)]
    if judge.model.field is None:
        return frames.names[first], []
    return frames.names[first], [(float(t), judge.render(first, float(t))[0], None) for t in np.linspace(0, 1, 8)]
