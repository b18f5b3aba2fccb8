"""The work of `depth`: reads depth maps or has a network make them, and aligns them to the scene's known points."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from ...pipeline import Context
from ...scene.seeds.one_place import DISTANCE
from ...scene.seeds.outliers import trusted
from ...scene.views import Views
from ...vision.depth.align import FEWEST, INVERSE, KINDS, SCALE, Sample, align
from ...vision.depth.network import DepthNetwork
from ...vision.depth.together import depth_of_inverse, is_inverse, scale_together
from ...vision.sequences import camera_sequences
from ...vision.triangulate import triangulate
from ..shared.dataset import load_frameset, load_views
from ..shared.frameset import FrameSet
from .artifact import StoredDepth, write_points

SIZE = 480  # px, longer side of the maps that are stored: all of them are in memory
POINTS = 1500  # of a frame, at most

Maps = Callable[[int], tuple[np.ndarray, np.ndarray] | None]


def find_depth(ctx: Context) -> None:
    """Writes the depth of all training frames that have any, and the points if they had to be triangulated."""
    frames = load_frameset(ctx.inputs, ctx.capture.root)
    views = load_views(frames, None)
    if frames.stands_still and not frames.enough_points:
        without_points(ctx, frames)
        return
    points = known_points(ctx, frames, views)
    maps, kinds = maps_of(ctx, frames)
    samples, small = {}, {}
    with ctx.progress(len(frames.train), "depth of frames") as bar:
        for i in (int(i) for i in frames.train):
            found = maps(i)
            if found is not None:
                samples[i], small[i] = sample_of(views, i, points, found[0], at_rest(frames, i)), _small(found)
            bar.advance(1)
    sequences = [[i for i in mine if i in small] for mine in camera_sequences(views.camera, views.time, frames.train).values()]
    aligned = align(samples, sequences, kinds)
    if aligned is None:
        some = any(len(one.value) >= FEWEST for one in samples.values())
        why = "it has little to do with the known points" if some else "no frame shows enough known points to align it to"
        ctx.log(f"it is not used, since {why}")
        return
    z = {i: aligned.depth(i, small[i][0]) for i in aligned.fits}
    stored = StoredDepth(aligned.kind, aligned.error, z, confidence(z, {i: sure for i, (_, sure) in small.items()}))
    stored.write(ctx.out, aligned.fits, aligned.errors)
    ctx.log(f"{len(z)} frames, {aligned.kind}, {aligned.error:.1%} off the known points")


def without_points(ctx: Context, frames: FrameSet) -> None:
    """The same before one camera that stands still: there are no points, so the maps are aligned to one another."""
    maps, kinds = maps_of(ctx, frames)
    values, sure, rest = {}, {}, {}
    with ctx.progress(len(frames.train), "depth of frames") as bar:
        for i in (int(i) for i in frames.train):
            found = maps(i)
            if found is not None and (found[0] > 0).any():
                values[i], sure[i] = _small(found)
                still = at_rest(frames, i)
                rest[i] = None if still is None else _small((still, still))[0]
            bar.advance(1)
    if not any((one > 0).any() for one in values.values()):
        ctx.log("it is not used, since no map has a known value")
        return
    inverse, told = (kinds == (INVERSE,), "of the network") if ctx.settings.model is not None else kind_of_files(values)
    depths = {i: depth_of_inverse(one) for i, one in values.items()} if inverse else values
    scales, errors = scale_together(depths, rest, DISTANCE)
    z = {i: (depths[i] / scale[0]).astype(np.float32) for i, scale in scales.items()}
    stored = StoredDepth(SCALE, float(np.median(list(errors.values()))), z, confidence(z, sure))
    stored.write(ctx.out, scales, errors)
    ctx.log(f"{len(z)} maps {told}; their median becomes {DISTANCE:g} world units; they agree to {stored.error:.1%} where nothing moves")


def kind_of_files(values: Mapping[int, np.ndarray]) -> tuple[bool, str]:
    """Whether the maps ``values`` [h, w] of a camera that stands still hold inverse depth, and how that was found, for people."""
    inverse = is_inverse(values)
    if inverse is None:
        return False, "of the capture, read as distances along the axis in any unit, since nothing passes in them that would tell"
    kind = "inverse distances" if inverse else "distances along the axis in any unit"
    return inverse, f"of the capture, which hold {kind}, by what passes before the background"


def confidence(z: Mapping[int, np.ndarray], sure: Mapping[int, np.ndarray]) -> dict[int, np.ndarray]:
    """[h, w] float32 in [0, 1] for each frame of ``z``: ``sure`` as a share of the most of all frames; 0 where no depth is known."""
    most = max(float(one.max()) for one in sure.values())
    return {i: np.where(z[i] > 0, np.clip(sure[i] / max(most, 1e-9), 0, 1), 0).astype(np.float32) for i in z}


def maps_of(ctx: Context, frames: FrameSet) -> tuple[Maps, tuple[str, ...]]:
    """What gives the values and the confidence [H, W] of a frame, None if it has none, and the kinds that they may be of."""
    if ctx.settings.model is None:
        return frames.depth, tuple(KINDS)
    network = DepthNetwork(ctx.settings.model, ctx.device)

    def by_network(i: int) -> tuple[np.ndarray, np.ndarray]:
        values = network.depth(frames.composited(i))
        return values, np.ones_like(values)

    return by_network, (network.kind,)


def known_points(ctx: Context, frames: FrameSet, views: Views) -> np.ndarray:
    """[P, 3] points at rest, world units: the capture's, SfM's or triangulated ones, without those that `trusted` leaves out."""
    if frames.enough_points:
        points = np.asarray(frames.points)
    else:
        ctx.log("triangulating points with the known poses")
        points, colors, _ = triangulate(frames)
        write_points(ctx.out, points, colors)
    return np.asarray(points[trusted(points, views.centres()[views.train])])


def at_rest(frames: FrameSet, i: int) -> np.ndarray | None:
    """[H, W] bool, where frame i shows what counts and is at rest, by the capture's own masks; None: everywhere."""
    moving, kept = frames.mask(i), frames.kept(i)
    if moving is None:
        return kept
    return moving <= 127 if kept is None else (moving <= 127) & kept


def sample_of(views: Views, i: int, points: np.ndarray, values: np.ndarray, rest: np.ndarray | None) -> Sample:
    """What the depth map ``values`` [H, W] of frame i says at the known ``points`` [P, 3] that the frame shows."""
    _, x, y, z = views.project(i, points)
    value = values[y, x] if rest is None else np.where(rest[y, x], values[y, x], 0)
    known = np.flatnonzero(value > 0)
    known = known[:: max(1, -(-len(known) // POINTS))]
    place = np.stack([x[known] / views.width, y[known] / views.height], 1)
    return Sample(value[known].astype(np.float64), z[known], place)


def _small(found: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Values and confidence with at most `SIZE` px on the longer side."""
    step = -(-max(found[0].shape) // SIZE)
    return found[0][step // 2 :: step, step // 2 :: step], found[1][step // 2 :: step, step // 2 :: step]
