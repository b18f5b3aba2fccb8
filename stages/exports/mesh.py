"""Exports the whole scene at one time as a triangle mesh. Colour and depth are rendered from the capture's cameras at that time and fused
by Open3D (TSDF, Curless and Levoy 1996)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
import torch

from ...pipeline import StageError
from ...pipeline.choice.evenly import evenly
from ...rasterizer import rasterize
from ...scene.hull_mesh import hull_mesh
from ...scene.losses.depth_spread import with_depth
from ...scene.mesh import Mesh
from ...scene.model import Model
from ...vision.clouds import load_open3d
from ..shared.posed_frameset import PosedFrameSet
from .bake import MOMENTS
from .capture_cameras import camera_of, distinct_views

CAMERAS, LOOKS = 150, 12  # most cameras that are fused, and most cameras from which the size of the scene is estimated
SOLID = 0.6  # alpha; pixels with less are not fused
SPREAD = 0.03  # of the depth; pixels with a larger spread, which show more than one surface along outlines, are not fused
FAR = 4.0  # median depths; surfaces farther away are not fused
FOOTPRINT = 1.5  # width of a voxel in pixels at the median depth,
ACROSS = 512  # but at most this many voxels lie along the scene
TRUNCATION = 4.0  # voxels in front of and behind a surface that store its distance
BLOCK = 8  # voxels along each side of a block
MOST_BLOCKS = 300_000  # of 10 KB each
SEEN = 1.0  # if there are several views, more than this many must have seen a voxel


class Look(NamedTuple):
    """A render from one camera. depth [H, W] float32, world units, 0 where nothing is fused; color [H, W, 3] float32 in [0, 1];
    K [3, 3] px; cam_from_world [4, 4]."""

    depth: np.ndarray
    color: np.ndarray
    K: np.ndarray
    cam_from_world: np.ndarray


class Size(NamedTuple):
    """In world units. voxel: width. farthest: depth up to which surfaces are fused. resolved: width that matches the cameras' pixels."""

    voxel: float
    farthest: float
    resolved: float = float("inf")


def look(model: Model, frames: PosedFrameSet, i: int, t: float) -> Look:
    """Renders ``model`` at time ``t`` from the camera of frame ``i``. Only solid pixels that show a single surface get a depth."""
    camera = camera_of(model, frames, i)
    with torch.no_grad():
        frame = rasterize(camera, *with_depth(camera, *model.at(t), unit=1.0), torch.zeros(3), antialiased=model.antialiased)
    alpha = frame.alpha.clamp(min=1e-6)
    first, second = (frame.extras / alpha[..., None]).unbind(-1)
    spread = (second - first.square()).clamp(min=0).sqrt()
    fused = (frame.alpha >= SOLID) & (spread <= SPREAD * frame.depth)
    color = (frame.color / alpha[..., None]).clamp(0, 1)  # rendered on black, so this is the surface's own colour
    return Look(
        torch.where(fused, frame.depth, 0).numpy(), color.numpy(), camera.K.double().numpy(), camera.cam_from_world.double().numpy()
    )


class NoSurface(StageError):
    """Nothing at a time can be fused."""


def size_of(model: Model, frames: PosedFrameSet, *moments: float) -> Size:
    """Voxel size that matches the resolution of the cameras, and the largest depth to fuse, over `MOMENTS` of the ``moments``, evenly
    spread, or over the first of the others with anything solid if these have nothing. Raises StageError if nothing is solid at any."""
    depths: list[np.ndarray] = []
    points, focal = [], []
    spread = evenly(range(len(moments)), MOMENTS)
    for k, number in enumerate([*spread, *(n for n in range(len(moments)) if n not in spread)]):
        if k >= len(spread) and any(len(one) for one in depths):
            break
        for i in distinct_views(frames, frames.train, LOOKS):
            seen = look(model, frames, int(i), moments[number])
            rows, columns = np.nonzero(seen.depth)
            z = seen.depth[rows, columns].astype(np.float64)
            rays = np.stack([columns + 0.5, rows + 0.5, np.ones(len(z))], 1) @ np.linalg.inv(seen.K).T
            rotation, shift = seen.cam_from_world[:3, :3], seen.cam_from_world[:3, 3]
            points.append((rays * z[:, None] - shift) @ rotation)
            depths.append(z)
            focal.append(seen.K[0, 0])
    z, places = np.concatenate(depths), np.concatenate(points)
    if not len(z):
        when = f"time {moments[0]:g}" if len(moments) == 1 else f"any of {len(moments)} times"
        raise NoSurface(f"export mesh: no camera of the capture sees anything solid at {when}; choose another --time, or train for longer")
    middle = float(np.median(z))
    low, high = np.percentile(places, (2, 98), axis=0)
    footprint = FOOTPRINT * middle / float(np.median(focal))
    voxel = max(footprint, float((high - low).max()) / ACROSS)
    return Size(voxel, FAR * middle, voxel)


def fuse(model: Model, frames: PosedFrameSet, t: float, size: Size, advance: Callable[[int], None] = lambda n: None) -> Mesh:
    """The mesh at time ``t``. ``advance`` is called once for each of the `fused_views`.

    Raises NoSurface if nothing is solid, StageError if Open3D is not available or voxels of that size do not fit in memory.
    """
    open3d = load_open3d("export mesh")
    core, geometry = open3d.core, open3d.t.geometry
    channels = [core.SizeVector([n]) for n in (1, 1, 3)]
    grid = geometry.VoxelBlockGrid(("tsdf", "weight", "color"), (core.float32,) * 3, channels, size.voxel, BLOCK, 10_000)
    views = fused_views(frames)
    for i in views:
        seen = look(model, frames, int(i), t)
        advance(1)
        if not seen.depth.any():
            continue
        K = seen.K.copy()
        K[:2, 2] -= 0.5  # Open3D's pixel centres lie at whole numbers
        depth, intrinsic, extrinsic = geometry.Image(seen.depth), core.Tensor.from_numpy(K), core.Tensor.from_numpy(seen.cam_from_world)
        try:
            blocks = grid.compute_unique_block_coordinates(depth, intrinsic, extrinsic, 1.0, size.farthest, TRUNCATION)
        except RuntimeError as error:
            # Open3D samples every fourth pixel along each side, and rejects a view in which none of these is near and solid.
            if "No block is touched" not in str(error):
                raise
            continue
        if max(len(blocks), grid.hashmap().size()) > MOST_BLOCKS:
            raise StageError(f"export mesh: voxels of {size.voxel:.3g} world units take more than 3 GB; give a larger --voxel")
        grid.integrate(blocks, depth, geometry.Image(seen.color), intrinsic, extrinsic, 1.0, size.farthest, TRUNCATION)
    triangles = np.zeros((0, 3))
    if grid.hashmap().size():  # Open3D fails on a grid without blocks
        surface = grid.extract_triangle_mesh(SEEN if len(views) > 1 else 0.5)
        triangles = surface.triangle.indices.numpy() if "indices" in surface.triangle else triangles
    if not len(triangles):
        large = size.voxel > size.resolved  # then the scene vanishes in them; small ones are each seen by too few pixels
        advice = f"a smaller --voxel (the pixels resolve {size.resolved:.3g})" if large else "a larger --voxel"
        raise NoSurface(
            f"export mesh: no surface at time {t:g} with voxels of {size.voxel:.3g} world units; give {advice}, or train for longer"
        )
    colors = surface.vertex.colors.numpy()
    return Mesh(
        surface.vertex.positions.numpy().astype(np.float32),
        np.concatenate([colors, np.ones((len(colors), 1))], axis=1).astype(np.float32),
        triangles.astype(np.int32),
    )


def fuse_all(
    model: Model, frames: PosedFrameSet, moments: Sequence[float], size: Size, advance: Callable[[int], None] = lambda n: None
) -> Iterator[Mesh]:
    """The mesh at each of ``moments``, as `fuse` has it. It has no triangles where there is no surface, except if there is one at none of
    them: then NoSurface is raised for the last."""
    lacking = 0
    for t in moments:
        try:
            made = fuse(model, frames, t, size, advance)
        except NoSurface:
            lacking += 1
            if lacking == len(moments):
                raise
            made = Mesh.empty()
        yield made


def fused_views(frames: PosedFrameSet) -> np.ndarray:
    """Frames whose cameras are fused."""
    return distinct_views(frames, frames.train, CAMERAS)


def hulls(model: Model, t: float, advance: Callable[[int], None] = lambda n: None) -> Mesh:
    """The hulls of the convexes of ``model`` at time ``t``. Triangles differ between times, since a corner may move inside the hull."""
    with torch.no_grad():
        _, convexes = model.at(t)
    advance(1)
    return hull_mesh(convexes)
