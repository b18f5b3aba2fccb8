"""`e4dgs export cameras CAPTURE`: the cameras that filmed the scene, as a file of poses and lenses."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from ...pipeline import counted, say
from ...pipeline.files import write_atomically
from ..options import of_last_run
from ..session import Options
from .meaning import without
from .trained import Up, axes_line, check_posed, is_file, open_trained, out_option, up_axis, writing

USUAL_UP = "-Y"  # as of .ply files

Out = Annotated[Path | None, out_option("FILE.json|DIR", "Output; by default scenes/<name>/export/cameras.")]


@of_last_run("coarse")
@without(
    times="every posed frame is written; leave it out",
    time="every posed frame is written; leave it out",
    antialiased="poses are not drawn; leave it out",
)
def cameras(options: Options, out: Out = None, up: Up = None) -> None:
    """Poses, lenses and times of all frames as JSON (nerfstudio's layout), in the axes of `export ply`; `export usd` has them, too."""
    axis, single = up_axis(up), is_file(out, (".json",))
    trained = open_trained(options)
    frames = trained.frames
    folder = trained.session.export_folder(out, "cameras")
    path = folder if single else folder / "transforms.json"

    from ...stages.exports.cameras import cameras_json, posed
    from ...stages.exports.splats import turn_of

    check_posed(options, frames, "are no cameras to write")
    turn = turn_of(frames, axis, USUAL_UP)
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, cameras_json(frames, turn))
    said = f"{counted(len(posed(frames)), 'pose')}, lenses without distortion for pictures of {frames.width}x{frames.height}"
    say(said, axes_line(turn, frames), f"cameras: {path}")
