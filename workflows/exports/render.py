"""`e4dgs render CAPTURE`: renders the trained scene along a camera path, as a video or as pictures and depth."""

from __future__ import annotations

import os
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer
from rich.console import Console

from ...pipeline import Progress, SettingsError, StageError, counted, say
from ..machine.places import FOLDERS, NamedFolder, is_folder, typed_path
from ..options import of_last_run
from ..session import Options
from .film import Asked, Film
from .trained import check_posed, open_trained, out_option, writing

if TYPE_CHECKING:
    from ...scene.model import Model
    from ...stages.exports.camera_path import CameraPath
    from ...stages.shared.posed_frameset import PosedFrameSet


@of_last_run("coarse")
def render(
    options: Options,
    out: Annotated[Path, out_option("FILE.mp4|DIR", "A video, or a folder for PNG files.")],
    path: Annotated[str, typer.Option("--path", metavar="NAME|FILE.json", help="turntable, spiral, capture, or a file.")] = "spiral",
    frames: Annotated[int | None, typer.Option("--frames", min=1, max=100_000, help="Number of pictures.")] = None,
    seconds: Annotated[
        float | None, typer.Option("--seconds", min=0.001, max=1e6, help="Duration; by default that of the capture, or 4 s.")
    ] = None,
    size: Annotated[
        int | None, typer.Option("--size", min=16, max=16_384, help="Longer side in px; by default that of the path file or the capture.")
    ] = None,
    time: Annotated[
        float | None, typer.Option("--time", min=0, max=1, help="Only this time, 0 to 1; by default time runs from 0 to 1.")
    ] = None,
    fps: Annotated[float | None, typer.Option("--fps", min=1, max=240, help="Pictures per second; 30 by default.")] = None,
    alpha: Annotated[bool, typer.Option("--alpha", help="PNG files without background, with alpha, and masks.")] = False,
    depth: Annotated[bool, typer.Option("--depth", help="Write depth as EXR beside each PNG.")] = False,
) -> None:
    """Render a trained scene along a path of the camera: a video, or pictures, alpha and depth."""
    if time is not None and not 0 <= time <= 1:  # NaN passes the option's own check
        raise SettingsError(f"--time {time}: give a number from 0 to 1")
    asked = Asked(frames, seconds, fps)
    video = _checked(out, alpha, depth)
    trained = open_trained(options)

    import torch

    from ...rasterizer import Camera
    from ...vision.images.movie import even, movie_file
    from ...vision.images.picture_folder import PictureFolder

    check_posed(options, trained.frames)
    model = trained.model.to(trained.session.job.device)
    views, (width, height), film, notes = _planned(path, trained.frames, model, asked, time)
    console = Console()
    say(*(f"note: {note}" for note in notes))
    wanted = (width, height) if size is None else _scaled(width, height, size)
    scale = np.diag([wanted[0] / width, wanted[1] / height, 1.0])  # pixel centres are at +0.5, so there is no offset
    width, height = (even(wanted[0]), even(wanted[1])) if video else wanted
    black = torch.zeros(3) if alpha else None
    with writing(out, "render"), Progress(film.count, "render", console) as bar, ExitStack() as stack:
        movie = stack.enter_context(movie_file(out, film.fps)) if video else None
        folder = None if video else stack.enter_context(PictureFolder(out, depth, alpha))
        for K, pose, t in zip(views.K, views.cam_from_world, views.time):
            camera = Camera(torch.tensor(scale @ K).float(), torch.tensor(pose).float(), width, height, model.near)
            frame = model.render(camera, float(t) if time is None else time, black)
            if movie is not None:
                movie.add((frame.color.clamp(0, 1) * 255).round().byte().cpu().numpy())
            elif folder is not None:
                folder.add(*(part.cpu().numpy() for part in (frame.color, frame.alpha, frame.depth)))
            bar.advance(1)
    cut = "" if (width, height) == wanted else f" (not {wanted[0]}x{wanted[1]}: the sizes of a video are even)"
    length = f", {film.seconds:.4g} s at {film.fps:.4g} a second ({film.why})" if video or film.why != "--frames" else ""
    say(f"{counted(film.count, 'picture')} of {width}x{height}{cut}{length}: {out}")


def _checked(out: Path, alpha: bool, depth: bool) -> bool:
    """Whether ``out`` is a video. Raises SettingsError or StageError if it cannot be written, or cannot hold what is asked for."""
    video = out.suffix.lower() == ".mp4" and not isinstance(out, NamedFolder)
    if depth and video:
        raise SettingsError("--depth: a video holds no depth; give a folder as --out")
    if alpha and video:
        raise SettingsError("--alpha: an mp4 video holds no transparency; give a folder as --out, for PNG files with alpha")
    if not video and not is_folder(out):
        raise SettingsError(f"--out {out}: the file must end in .mp4; or name a folder for PNG files: {FOLDERS}")
    if video and out.is_dir():
        raise SettingsError(f"--out {out}: this is a folder; name a file that ends in .mp4, or a folder without that ending")
    whole = out.absolute()
    places = whole.parents if video else (whole, *whole.parents)  # a folder that is there is written into, and its parent is not
    place = next(place for place in places if place.exists())
    if not place.is_dir():
        raise SettingsError(f"--out {out}: {place} is a file, not a folder; give another --out")
    if not os.access(place, os.W_OK | os.X_OK):  # the library that writes videos would say that there is no such file
        raise StageError(f"render: --out {out}: {place} cannot be written; give another --out")
    return video


def _planned(
    path: str, frames: PosedFrameSet, model: Model, asked: Asked, time: float | None
) -> tuple[CameraPath, tuple[int, int], Film, tuple[str, ...]]:
    """The views that ``--path`` asks for, their size, the film that they make, and notes. Raises SettingsError for a name that is neither a
    known path nor a file, and for options that do not fit."""
    from ...stages.exports.camera_path import NAMES, named_path, seconds_of
    from .camera_path import path_of_file

    if path in NAMES:
        film = asked.film(seconds_of(path, frames, moves=time is None and not model.motion.static))
        return named_path(path, frames, model, film.count, film.seconds), (frames.width, frames.height), film, ()
    file = typed_path(path)
    if not file.is_file():
        raise SettingsError(f"--path {path}: neither one of {', '.join(NAMES)} nor a file")
    views = path_of_file(file, frames)
    return views, views.size, asked.film_of(len(views.time), views.fps), views.notes


def _scaled(width: int, height: int, size: int) -> tuple[int, int]:
    """(width, height) with a longer side of ``size``."""
    return max(1, round(width * size / max(width, height))), max(1, round(height * size / max(width, height)))
