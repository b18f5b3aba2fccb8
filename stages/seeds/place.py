"""Where Gaussians begin, and which of them are dynamic."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...pipeline import Context
from ...pipeline.choice.evenly import evenly
from ...scene.seeds.carve import carve
from ...scene.seeds.moving.at_rest import StaticScene
from ...scene.seeds.moving.moving_seeds import MovingSeeds
from ...scene.seeds.outliers import trusted
from ...scene.seeds.volume import common_volume
from ...scene.training.control.dynamics import dynamic_from_masks
from ...scene.training.curriculum import MIN_CAMERAS
from ...scene.views import Views
from ...vision.triangulate import triangulate
from ..depth.artifact import StoredDepth, read_depth, read_points
from ..facts import Facts
from ..flow.artifact import flow_of
from ..shared.frameset import FrameSet
from ..shared.masks import moving_mask
from .fill import fill_seeds, middle_frames, sweep
from .given_objects import static_inverse
from .key_times import KEYS, rig_times
from .moving import FEWEST_CAMERAS, camera_seeds, rig_seeds
from .one_place import standing_seeds

# A seed is dynamic if at least this share of the masks that see it mark it as moving.
FIXED_SHARE = 0.3  # masks of fixed cameras, each marking all pixels that ever change
MOVING_SHARE = 0.5  # masks of single frames of a moving camera, if moving objects have seeds of their own
COVERED_SHARE = 0.05  # the same, if they have none and seeds that they sometimes hide must represent them
SWEPT_SHARE = 0.7  # largest share of the seeds that a plane sweep may provide,
SWEPT_DENSITY = 1.5  # and relative to the share of the pixels whose depth it found: the others need seeds, too
LEAST_POINTS = 30  # least number of points for depths interpolated between them to be meaningful
LONGEST = 4  # times the usual number of seeds on what moves, the most for a long clip
LOOKS = 60  # masks of a moving camera that are used


class PlacedSeeds(NamedTuple):
    """points [N, 3] world units, colors [N, 3] in [0, 1]. trusted [P, 3]: points that were measured, not guessed. inverse_depth: of the
    static scene in front of each camera, see `Swept`. given: depth that came with the capture. swept: of ``inverse_depth``, what the
    plane sweep found."""

    points: np.ndarray
    colors: np.ndarray
    trusted: np.ndarray
    inverse_depth: dict[int, np.ndarray]
    given: StoredDepth | None = None
    swept: dict[int, np.ndarray] | None = None


def load_seeds(ctx: Context, frames: FrameSet, views: Views, count: int, fill: bool = False) -> PlacedSeeds:
    """Initial positions of Gaussians: points of the capture or SfM, otherwise carved silhouettes, otherwise triangulated points. Seeds of
    rigs are filled up to about ``count``, and so are those of captures whose points have to be triangulated, and with ``fill`` also
    those of others."""
    settings = ctx.settings
    if frames.stands_still and not frames.enough_points:
        standing = standing_seeds(ctx, frames, views, count)
        return PlacedSeeds(standing.points, standing.colors, standing.points, standing.inverse, standing.given)
    if frames.enough_points:
        points, colors = np.asarray(frames.points), np.asarray(frames.point_colors) / 255.0
        ctx.log(f"seeds: {len(points)} points of the capture or of SfM")
        fill = fill or len(middle_frames(views)) >= MIN_CAMERAS
    elif Facts.of(ctx.facts).alpha:
        chosen = views.train[:: max(1, len(views.train) // 60)]
        objects = [frames.image(int(i))[..., 3] > 127 for i in chosen]
        ctx.log(f"seeds: {count} points inside the silhouettes of {len(chosen)} views")
        points, colors = carve(views, objects, chosen, count, settings.seed)
        return PlacedSeeds(points, colors, points, {})
    else:
        points, colors = triangulated(ctx, frames)
        fill = True
    keep = trusted(points, views.centres()[views.train])
    points, colors = points[keep], colors[keep]
    ctx.log(f"seeds: {len(points)} points; {int((~keep).sum())} isolated ones are left out")
    measured = points
    given = given_depth(ctx)
    swept = sweep(ctx, frames, views, points) if fill and len(points) >= LEAST_POINTS else None
    if swept is not None:
        share = min(SWEPT_SHARE, SWEPT_DENSITY * swept.known)
        chosen = np.random.default_rng(settings.seed).permutation(len(swept.points))[: int(share * count)]
        points, colors = np.concatenate([points, swept.points[chosen]]), np.concatenate([colors, swept.colors[chosen]])
    if fill and LEAST_POINTS <= len(points) < count:
        more, their_colors = fill_seeds(ctx, frames, views, points, count - len(points))
        points, colors = np.concatenate([points, more]), np.concatenate([colors, their_colors])
    elif fill and len(points) < count:
        centre, radius = common_volume(views)
        more = centre + np.random.default_rng(settings.seed).uniform(-radius, radius, (count, 3))
        ctx.log(f"seeds: {len(more)} more spread over the volume that the cameras share")
        points, colors = np.concatenate([points, more]), np.concatenate([colors, np.full((count, 3), 0.5)])
    found = swept.inverse if swept else {}
    inverse = found if given is None else static_inverse(given, found)
    return PlacedSeeds(points, colors, measured if len(measured) else points, inverse, given, found)


def triangulated(ctx: Context, frames: FrameSet) -> tuple[np.ndarray, np.ndarray]:
    """Points [P, 3] and their colours [P, 3] in [0, 1]: those to which `depth` was aligned, else new ones."""
    known = read_points(ctx.inputs.get("depth"))
    if known is None:
        ctx.log("seeds: triangulating points with the known poses")
        known = triangulate(frames, seed=ctx.settings.seed)[:2]
    return known[0], known[1] / 255.0


def given_depth(ctx: Context) -> StoredDepth | None:
    """The maps of `depth`, None if there are none."""
    given = read_depth(ctx.inputs.get("depth"))
    if given is not None:
        use = "for what moves and where nothing else gives the depth of what is at rest" if given.precise else "for what moves"
        ctx.log(f"seeds: depth of {len(given.z)} frames, {given.error:.1%} off the known points, is used {use}")
    return given


def moving_seeds(ctx: Context, frames: FrameSet, views: Views, seeds: PlacedSeeds, most: int) -> MovingSeeds | None:
    """Up to ``most`` seeds on moving objects, at several times; None without masks of moving pixels. seeds: mostly of what is static. In
    front of one camera, they are more if there are more than `KEYS` times, since each
    is present for a short time, unless the number of Gaussians is limited by a setting."""
    flow = flow_of(ctx.inputs)
    if flow is None or not flow.has_moving:
        return None
    several = len(middle_frames(views)) >= FEWEST_CAMERAS
    if Facts.of(ctx.facts).rig or (flow.has_ever_moving and several):
        rows = rig_times(flow, np.unique(views.time[views.train]), most)
        with ctx.progress(len(rows), "seeds on moving objects") as bar:
            found = rig_seeds(flow, views, lambda i: moving_mask(ctx, frames, i), rows, most, ctx.settings.seed, bar.advance)
    else:
        with ctx.progress(len(views.train), "seeds on moving objects") as bar:
            longest = most if ctx.settings.budget else LONGEST * most
            rest = StaticScene(views, seeds.swept) if seeds.swept and not frames.fixed_cameras else None  # plates show no frame as it was
            found = camera_seeds(flow, views, seeds.points, most // KEYS, longest, bar.advance, seeds.given, rest)
    if found is not None:
        ctx.log(f"seeds: {len(found.points)} on moving objects, at {len(np.unique(found.time))} times")
    return found


def initial_dynamic(ctx: Context, points: np.ndarray, views: Views, moving_seeded: bool) -> np.ndarray:
    """[N] bool, seeds that are dynamic at first. Masks of fixed cameras show which pixels ever change; masks of single frames show what a
    moving camera saw move. Without masks all seeds are dynamic until the field shows otherwise.

    moving_seeded: moving objects have seeds of their own, so ``points`` need not represent them.
    """
    flow = flow_of(ctx.inputs)
    if moving_seeded and len(np.unique(views.camera)) == 1 and flow is not None and flow.has_ever_moving:
        return np.zeros(len(points), bool)  # one camera that stands still: they lie behind what moves
    if flow is not None and flow.has_ever_moving:
        first = {int(c): int(i) for i, c in reversed(list(enumerate(views.camera)))}
        looks = [(first[camera], mask) for camera, mask in flow.ever_moving_masks()]
        share, where = FIXED_SHARE, "no fixed camera sees a change"
    elif flow is not None and flow.has_moving:
        train = views.train
        chosen = evenly(train, LOOKS)
        looks = [(int(i), flow.moving(int(i))) for i in chosen]
        share, where = MOVING_SHARE if moving_seeded else COVERED_SHARE, "hardly anything was seen to move"
    else:
        return np.ones(len(points), bool)
    dynamic = dynamic_from_masks(points, views, looks, share)
    ctx.log(f"{int((~dynamic).sum())} of {len(points)} seeds lie where {where} and skip the field")
    return dynamic
