"""Stage `poses`: structure from motion for captures without camera poses. docs/artifacts.md documents the arrays and attributes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from pydantic import Field

from ..pipeline import Applies, Context, Resources, Settings, Stage, StageError
from ..vision.sfm.pairs import OVERLAP, choose, image_pairs
from .facts import Facts

if TYPE_CHECKING:
    import numpy as np

    from ..vision.sfm.coverage import Coverage
    from .artifacts.frameset import FrameSet
    from .posing.several import Several

INIT_ANGLES = (16.0, 4.0, 1.5)  # degrees, least triangulation angle of the initial image pair; tried in order, from good to last resort


class PosesSettings(Settings):
    renamed: ClassVar = {"movers": "moving"}

    matcher: Literal["auto", "sequential", "exhaustive"] = Field(
        "auto", description="which images are matched; auto: all, up to 40 images or with --static; else neighbours and keyframes"
    )
    overlap: int = Field(OVERLAP, ge=2, le=100, description="sequential: number of following frames that each frame is matched with")
    camera_model: Literal["SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV"] = Field(
        "SIMPLE_RADIAL", description="lens model that is fitted; OPENCV suits wide lenses with many images"
    )
    max_features: int = Field(8192, ge=256, le=65_536, description="most SIFT features per image")
    mapper: Literal["incremental", "global"] = Field("incremental", description="COLMAP's incremental mapper or the global one (GLOMAP)")
    moving: Literal["auto", "off"] = Field(
        "auto", description="auto: a second pass without features on moving objects, if there are enough of these; the better pass is kept"
    )
    seed: int = Field(0, ge=0, le=2**31 - 1, description="seed of the random sampling")


class Poses(Stage):
    """Intrinsics and a pose for every frame that registers, sparse points, and a report of which frames did not register and why."""

    name = "poses"
    inputs = ("frames",)
    settings = PosesSettings
    reads_capture = True

    def applies(self, facts: Mapping[str, Any], settings: PosesSettings) -> Applies:
        known = Facts.of(facts)
        if known.poses:
            return Applies.no("the files hold poses")
        if known.cameras > 1 and not known.static:
            return Applies.yes(
                f"structure from motion on {known.cameras} cameras at shared times; those that stand still get one pose each"
            )
        again = "" if settings.moving == "off" or known.static else "; a second pass if moving objects could disturb the cameras"
        return Applies.yes(f"structure from motion on {known.frames} frames{again}")

    def estimate(self, facts: Mapping[str, Any], settings: PosesSettings) -> float | None:
        """Measured on one core: features 0.1 s + 1.3 s per megapixel, 0.06 s per pair, 0.9 s to register an image (half if the camera
        only turns), 0.2 s to adjust it, 0.15 s to find moving objects, 8 s for the start and the test whether the camera only turns. A
        second pass is not counted; it takes the time of registering once more and a third of the pairs' time. Several cameras are assumed
        to stand still, as most do."""
        from ..vision.sfm.looks import look_times

        known = Facts.of(facts)
        frames = known.frames
        if known.cameras > 1 and not known.static:
            cameras, times = known.cameras, look_times(known.cameras, known.times)
            features, pairs = cameras * times * (0.1 + 1.3 * known.width * known.height / 1e6), times * cameras * (cameras - 1) / 2
            return 10 + features + 0.2 * pairs + 2.0 * cameras
        pairs = len(image_pairs(choose(settings.matcher, frames, known.static), frames, settings.overlap))
        looked = 0.15 if settings.moving == "auto" and not known.static else 0.0
        return 8 + frames * (1.2 + looked + 1.3 * known.width * known.height / 1e6) + 0.06 * pairs

    def resources(self, facts: Mapping[str, Any], settings: PosesSettings, device: str) -> Resources:
        from .estimates import picture_resources

        return picture_resources(Facts.of(facts), 2.0)

    def run(self, ctx: Context) -> None:
        import numpy as np

        from ..vision.sfm.coverage import cover
        from ..vision.sfm.runner import WorkerError, finished, run_worker
        from ..vision.sfm.trouble import nothing_registered
        from .artifacts.frameset import FrameSet
        from .artifacts.poses import write_account
        from .posing.bars import Bars
        from .posing.pictures import lens_groups, write_images, write_masks
        from .posing.second_pass import second_pass

        settings, static = ctx.settings, Facts.of(ctx.facts).static
        artifact = ctx.inputs["frames"]
        assert artifact is not None
        frames = FrameSet(artifact, ctx.capture.root)
        matcher = choose(settings.matcher, len(frames), static)
        hint = frames.K_hint
        several = _several(ctx, frames) if len(np.unique(frames.camera)) > 1 and not static else None
        request = {
            "task": "reconstruct",
            "root": str(ctx.checkpoints / "images"),
            "names": [] if several else write_images(ctx, frames),
            "cameras": lens_groups(frames),
            "K_hint": None if hint is None else np.asarray(hint, np.float64).reshape(3, 3).tolist(),
            "keep": None if frames.keep_files is None else str(write_masks(ctx, frames)),
            "width": frames.width,
            "height": frames.height,
            "camera_model": settings.camera_model,
            "max_features": settings.max_features,
            "pairs": [] if several else image_pairs(matcher, len(frames), settings.overlap),
            "mapper": settings.mapper,
            "init_angles": INIT_ANGLES,
            "static": static,
            "seed": settings.seed,
            **(several.request if several else {}),
        }
        bars, folder = Bars(ctx), ctx.checkpoints / "colmap"
        share, told = None, "poses.moving=off"
        try:
            arrays, facts = finished(request, folder) or run_worker(request, folder, bars)
            if several and several.looks.fixed:
                told = "cameras that stand still are matched only at equal times, when moving objects are as useful as static ones"
            elif settings.moving == "auto":
                passes = second_pass(frames, request, folder, (arrays, facts), static, bars)
                arrays, facts, share, told = passes.arrays, passes.facts, passes.moving_share, passes.told
                if passes.trouble:
                    ctx.log(passes.trouble)
        except WorkerError as error:
            # The next run must not resume from these databases: one of them may be the cause of the failure.
            for database in folder.glob("*.db"):
                database.unlink(missing_ok=True)
            raise StageError(str(error)) from error
        finally:
            bars.close()

        if several:
            arrays, facts = several.of_frames(frames, arrays, facts)
        residuals = arrays["residuals"]
        if arrays["registered"].sum() < min(3, len(frames)) or not len(residuals):
            raise StageError(nothing_registered(len(frames), facts["features"], facts["pairs"], matcher))
        mean_error, median_error = float(residuals.mean()), float(np.median(residuals))
        angle = float(np.median(arrays["angles"]))
        # If the camera only turns, a note already says so, and small angles need no further advice.
        judged = 90.0 if facts["turning"] else angle
        if several:
            write_account(ctx.out, fixed_cameras=several.looks.all_fixed)
        coverage = cover(arrays["registered"], facts["features"], facts["parts"], matcher, mean_error, judged)
        ctx.log(f"{coverage.summary()}, mean reprojection error {mean_error:.2f} px, median {median_error:.2f} px")
        for sentence in facts["notes"]:
            ctx.log(sentence)
        if settings.moving == "auto":
            ctx.log(f"moving objects: {told}")
        for sentence in coverage.advice:
            ctx.log(sentence)
        _write(ctx, frames, arrays, coverage)
        write_account(
            ctx.out,
            mean_reprojection_error=mean_error,
            median_reprojection_error=median_error,
            median_angle=angle,
            parts=facts["parts"],
            notes=facts["notes"],
            matcher=matcher,
            moving_share=None if share is None else round(share, 4),
            second_pass=told,
        )


def _several(ctx: Context, frames: FrameSet) -> Several:
    """The worker's request for a capture with several cameras. Writes the pictures that it uses."""
    from .posing.pictures import picture_folder, write_picture
    from .posing.several import several_cameras

    folder = picture_folder(ctx)
    with ctx.progress(Facts.of(ctx.facts).cameras, "which cameras stand still") as bar:
        found = several_cameras(
            frames,
            ctx.checkpoints / "colmap",
            ctx.settings.matcher,
            ctx.settings.overlap,
            lambda i: write_picture(frames, i, folder),
            lambda: bar.advance(1),
        )
    ctx.log(found.told)
    return found


def _write(ctx: Context, frames: FrameSet, arrays: dict[str, np.ndarray], coverage: Coverage) -> None:
    import numpy as np

    from ..vision.images.lenses import pinholes
    from ..vision.sfm.world import POINT_ERROR, keep_points, normalise
    from .artifacts.poses import StoredPoses, write_account

    registered = arrays["registered"]
    keep = keep_points(arrays["points"], arrays["errors"], arrays["tracks"])
    if not keep.any():
        raise StageError(f"every triangulated point has a reprojection error above {POINT_ERROR} px; try another poses.camera_model")
    K, cam_from_world = arrays["K"], arrays["cam_from_world"]
    # COLMAP read the files, which may be larger than the frames. Pixel centres lie at +0.5 in both, so K scales without an offset.
    size = np.array([frames.width, frames.height]) / np.maximum(arrays["size"], 1)
    K[:, 0] *= size[:, :1]
    K[:, 1] *= size[:, 1:]
    cam_from_world[registered], points = normalise(cam_from_world[registered], arrays["points"][keep])

    lens_K = K
    K, kept = pinholes(lens_K, arrays["distortion"], None, frames.width, frames.height)
    if not kept.all():
        raise StageError(
            f"{frames.names[int(kept.argmin())]}: the lens that was fitted folds the picture over; try another poses.camera_model"
        )
    StoredPoses(
        K=K,
        lens_K=None if np.array_equal(K, lens_K, equal_nan=True) else lens_K,
        cam_from_world=cam_from_world,
        distortion=arrays["distortion"],
        registered=registered,
        points=points,
        point_colors=arrays["colors"][keep],
        point_errors=arrays["errors"][keep],
    ).write(ctx.out)
    write_account(
        ctx.out,
        registered=coverage.registered,
        total=coverage.total,
        gaps=[list(gap) for gap in coverage.gaps],
        mean_track_length=float(arrays["tracks"].mean()),
        camera_model=ctx.settings.camera_model,
        mapper=ctx.settings.mapper,
        advice=list(coverage.advice),
    )
