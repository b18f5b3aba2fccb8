"""`e4dgs export mesh CAPTURE`: the whole scene as a triangle mesh, at one time or at several."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer
from rich.console import Console

from ...pipeline import Progress, SettingsError, StageError, counted, say
from ...pipeline.files import write_atomically
from ...scene.formats.axes import Turn
from ...stages.exports.numbered import new_sequence, numbered, write_index
from ..options import of_last_run
from ..session import Options
from .meaning import without
from .trained import (
    Moment,
    Trained,
    Up,
    axes_line,
    check_moment,
    check_single,
    check_strangers,
    is_file,
    open_trained,
    out_option,
    times_option,
    up_axis,
    writing,
)

if TYPE_CHECKING:
    from ...scene.mesh import Mesh

ENDINGS = (".glb", ".ply")
MARGIN = 2000  # bytes of a .glb file for each time beside its arrays: its JSON and animation
USUAL_RATE = 24.0  # times per second for a capture without seconds
UP = {".glb": "Y", ".ply": "Z"}  # glTF says +Y is up; Blender and CloudCompare take +Z for up in a .ply file

Out = Annotated[Path | None, out_option("FILE.glb|FILE.ply|DIR", "Output; by default scenes/<name>/export/mesh.")]
Times = Annotated[int | None, times_option("Number of times, first to last; by default the middle one, for --convexes all, at most 60.")]
Hulls = Annotated[bool, typer.Option("--convexes", help="Only the hulls of the model's convexes.")]
Voxel = Annotated[
    float | None, typer.Option("--voxel", metavar="SIZE", help="Width of a voxel in world units; by default what the pixels resolve.")
]


@of_last_run("coarse")
@without(antialiased="triangles have no opacity to compensate; leave it out")
def mesh(
    options: Options, out: Out = None, times: Times = None, time: Moment = None, voxel: Voxel = None, convexes: Hulls = False, up: Up = None
) -> None:
    """The whole scene as a coloured triangle mesh, fused from depth: a .ply file for each time, or a .glb file that plays."""
    if voxel is not None and not 0 < voxel < float("inf"):
        raise SettingsError(f"--voxel {voxel}: give a positive size in world units")
    if convexes and voxel is not None:
        raise SettingsError("--voxel: the hulls of convexes are exact and have no voxels; leave out --voxel or --convexes")
    check_moment(time, times)
    axis, single = up_axis(up), is_file(out, ENDINGS)
    ending = out.suffix.lower() if single and out is not None else ".ply"
    if single and out is not None and ending == ".ply":
        check_single(out, times or 1, ".ply")
    trained = open_trained(options)
    target = trained.session.export_folder(out, "mesh")
    if not single:
        check_strangers(out, ".ply")
    every = convexes and time is None and not (single and ending == ".ply")
    count = trained.moments(times) if every or times is not None else 1
    moments = [0.5 if time is None else time] if count == 1 else [float(t) for t in np.linspace(0, 1, count)]

    from ...stages.exports.mesh import fuse_all, fused_views, hulls, size_of
    from ...stages.exports.splats import turn_of

    turn = turn_of(trained.frames, axis, UP[ending])
    console = Console()
    if convexes:
        if not len(trained.model.convexes):
            raise SettingsError(f"{options.capture}: its model has no convexes; leave out --convexes, or train with a larger hulls.budget")
        made = counted(len(trained.model.convexes), "convex", "convexes")
        with Progress(count, "export", console) as bar, writing(target):
            triangles = write_meshes(trained, (hulls(trained.model, t, bar.advance) for t in moments), moments, target, single, turn)
    else:
        size = size_of(trained.model, trained.frames, *moments)
        size = size if voxel is None else size._replace(voxel=voxel)
        made = f"voxels of {size.voxel:.3g} world units"
        with Progress(count * len(fused_views(trained.frames)), "export", console) as bar, writing(target):
            meshes = fuse_all(trained.model, trained.frames, moments, size, bar.advance)
            triangles = write_meshes(trained, meshes, moments, target, single, turn)
    empty = [k for k, number in enumerate(triangles) if not number]
    notes = list(trained.thinned(count, times))
    if empty:
        notes.append(f"note: no surface at {len(empty)} of {count} times, first at time {moments[empty[0]]:g}; there the mesh is empty")
    least, most = min(triangles), max(triangles)
    said = (counted(most, "triangle") if least == most else f"{least} to {most} triangles") + (f" at {count} times" if count > 1 else "")
    say(f"{said}; {made}", *notes, axes_line(turn, trained.frames), f"mesh: {target}")


def _fitting(meshes: Iterable[Mesh], moments: Sequence[float], target: Path) -> Iterator[Mesh]:
    """``meshes``, as they come. Raises StageError as soon as a .glb file cannot hold them."""
    from ...scene.formats.glb import MOST_BYTES

    size = 0
    for t, one in zip(moments, meshes):
        size += one.bytes_in_glb
        if target.suffix.lower() == ".glb" and size > MOST_BYTES - MARGIN * len(moments):
            took, most = f"{size / 1e9:.2f} GB", f"{MOST_BYTES / 1e9:.2f} GB"
            raise StageError(
                f"export mesh: {target}: up to time {t:g} its meshes take {took}, and a .glb file holds {most} at most; "
                "name a folder, for a .ply file a time, or give fewer --times or, without --convexes, a larger --voxel"
            )
        yield one


def write_meshes(trained: Trained, meshes: Iterable[Mesh], moments: Sequence[float], target: Path, single: bool, turn: Turn) -> list[int]:
    """Writes ``meshes`` at ``moments`` in [0, 1] to ``target``: a .glb file with all of them, a .ply file with one, or a folder of numbered
    .ply files in place of those of an earlier export. turn: from the capture's axes to those of the files. Returns the number of triangles
    of each. Raises StageError if there is none at any moment."""
    from ...scene.mesh import mesh_glb_bytes, mesh_ply_bytes
    from ...stages.exports.bake import nothing_visible
    from ...stages.exports.splats import origin_of

    if single:
        whole = list(_fitting(meshes, moments, target))
        if not any(len(one.triangles) for one in whole):
            raise nothing_visible("mesh", moments)
    if single and target.suffix.lower() == ".glb":
        seconds = float(np.ptp(trained.frames.seconds)) or (trained.times - 1) / USUAL_RATE
        write_atomically(target, mesh_glb_bytes(whole, [t * seconds for t in moments], turn))
        return [len(one.triangles) for one in whole]
    if single:
        (one,) = whole
        write_atomically(target, mesh_ply_bytes(one, turn))
        return [len(one.triangles)]
    triangles = []
    with new_sequence(target, ".ply") as folder:
        for k, one in enumerate(meshes):
            write_atomically(numbered(folder, k, ".ply"), mesh_ply_bytes(one, turn))
            triangles.append(len(one.triangles))
        if not any(triangles):
            raise nothing_visible("mesh", moments)
        about = {"format": "mesh", "up": turn.after, **origin_of(trained.frames)}
        write_index(folder, ".ply", moments, float(np.ptp(trained.frames.seconds)), about)
    return triangles
