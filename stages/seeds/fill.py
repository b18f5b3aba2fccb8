"""Seeds where feature matching found no points: along rays, on a shell around the scene, and from a plane sweep."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from ...pipeline import Context
from ...pipeline.choice.evenly import evenly
from ...scene.seeds.clean_plates import clean_plates
from ...scene.seeds.colours import median_colours
from ...scene.seeds.rays import ray_seeds
from ...scene.seeds.shell import shell_seeds, surrounded
from ...scene.seeds.sweep import plane_sweep, points_of
from ...scene.training.curriculum import MIN_CAMERAS
from ...scene.views import Views
from ..shared.frameset import FrameSet
from ..shared.masks import unsteady_mask

SHELL_SHARE = 0.1
LOOKS = 32  # frames of a moving camera from which rays start
LEAST_SEEN = 2  # frames that must show a seed, but for rays of a rig


def fill_seeds(ctx: Context, frames: FrameSet, views: Views, points: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Up to ``count`` seeds [n, 3] (world units) in addition to the trusted ``points`` [P, 3], with their colours [n, 3] in [0, 1].

    For a rig the frames of the middle time are used, where training begins; for a moving camera, frames along its whole path.
    """
    chosen = middle_frames(views)
    rig = len(chosen) >= MIN_CAMERAS
    if not rig:
        chosen = evenly(views.train, LOOKS)
    masks = [unsteady_mask(ctx, frames, int(i)) for i in chosen]
    seed = ctx.settings.seed
    found: dict[str, np.ndarray] = {}
    colors: list[np.ndarray] = []
    static = [np.ones((views.height, views.width), bool) if mask is None else ~mask for mask in masks]
    shell = shell_seeds(views, points, int(SHELL_SHARE * count), seed) if surrounded(views) else np.zeros((0, 3))
    rays = ray_seeds(views, points, chosen, count - len(shell), seed, skip=[~s for s in static])
    for name, seeds in (("along rays", rays), ("on the shell around them", shell)):
        color, seen = median_colours(views, seeds, chosen, static)
        # What one camera of a rig alone sees would stay a hole: growth only splits what is there.
        least = 1 if rig and name == "along rays" else min(LEAST_SEEN, len(chosen))
        found[name] = seeds[seen >= least]
        colors.append(color[seen >= least])
    ctx.log("seeds: " + ", ".join(f"{len(seeds)} {name}" for name, seeds in found.items()))
    return np.concatenate(list(found.values())), np.concatenate(colors)


class Swept(NamedTuple):
    """points [n, 3] static (world units), colors [n, 3] in [0, 1]. inverse: inverse depth by frame, [h, w] float32, 1 / world units, 0
    where the depth is unknown or something moves; all frames of a fixed camera share one map. known: share of the pixels with a depth."""

    points: np.ndarray
    colors: np.ndarray
    inverse: dict[int, np.ndarray]
    known: float


def sweep(ctx: Context, frames: FrameSet, views: Views, points: np.ndarray) -> Swept | None:
    """Result of a plane sweep between the cameras of the middle time, or along the path of few cameras; None if it finds no depth.
    points [P, 3]: trusted points."""
    fixed = frames.fixed_cameras
    plates = clean_plates(views, lambda i: unsteady_mask(ctx, frames, i), fixed)
    with ctx.progress(len(plates.frames), "depth") as bar:
        maps = plane_sweep(views, plates.frames.tolist(), plates.pictures, points, bar.advance)
    if not maps:
        ctx.log("seeds: no depth by plane sweep: no two views of the known points are at a suitable angle")
        return None
    place = {int(i): k for k, i in enumerate(plates.frames)}
    for one in maps:
        h, w = one.inverse.shape
        static = cv2.resize(plates.static[place[one.frame]].astype(np.uint8), (w, h), interpolation=cv2.INTER_AREA)
        one.inverse = np.where(static > 0, one.inverse, 0.0).astype(np.float32)
    found, frame, at = points_of(maps, views)
    pictures = np.stack(plates.pictures)
    colors = pictures[[place[int(i)] for i in frame], at[:, 1].astype(int), at[:, 0].astype(int)] / 255.0
    known = len(found) / sum(one.inverse.size for one in maps)
    ctx.log(f"seeds: the plane sweep gives the depth of {known:.0%} of the pixels of {len(maps)} {'cameras' if fixed else 'frames'}")
    inverse = {one.frame: one.inverse for one in maps}
    if fixed:
        of_camera = {int(views.camera[frame]): one for frame, one in inverse.items()}
        inverse = {int(i): of_camera[int(views.camera[i])] for i in views.train if int(views.camera[i]) in of_camera}
    return Swept(found, colors, inverse, known)


def middle_frames(views: Views) -> np.ndarray:
    """[n] int: training frames of the middle time, from which the window of training times grows."""
    times = np.unique(views.time[views.train])
    return views.train[views.time[views.train] == times[len(times) // 2]]
