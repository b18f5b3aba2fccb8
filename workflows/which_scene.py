"""Which scene, capture and run the words of a command mean; without options that choose a run, the last one."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from ..pipeline import ArtifactError, CaptureError, SettingsError
from ..pipeline.names import composed
from .last_run import FILE, last_run
from .machine.devices import resolve_device
from .scenes import owner_of, scenes_in, scenes_of
from .session import DEFAULT_WORKSPACE, NO_CHOICE, Choice, Options


class NoRunError(ArtifactError):
    """What a command shows or writes has not been made yet. Nothing failed, so this is a matter of its arguments: exit code 2."""

    exit_code = SettingsError.exit_code


@dataclass(frozen=True)
class Given:
    """The options of a command that looks at the results of a run. choose: whether any of them chooses among runs."""

    capture: Path | None
    workspace: Path
    choice: Choice = NO_CHOICE
    name: str | None = None
    choose: bool = False


def options_of_last_run(given: Given, stage: str, done: bool = True) -> Options:
    """The options of the run that a command means. If none of those that choose a run is given, they are those of the last run that
    included ``stage``, of the capture or scene, or of the whole workspace without either. A line says so unless that run had none. done:
    prefer a run that came to its end.

    Raises NoRunError if neither a capture nor a scene is given and nothing has run in the workspace, CaptureError if there is no such
    capture."""
    if given.capture is None and given.name is None:
        scene = _newest([folder.parent for folder in (given.workspace / "scenes").glob(f"*/{FILE}")], stage)
        if scene is None:
            raise NoRunError(f"{given.workspace}: no run is known in this workspace; name a capture, or another --workspace")
    else:
        scene = _scene(given, stage)
    capture, name, workspace = scene_or_capture(given.capture or scene or Path(), given.workspace, given.name)
    if not capture.exists():
        raise CaptureError(_absent(capture, name, given.workspace))
    run = None if scene is None or given.choose else last_run(scene, stage, done) or last_run(scene)
    if run is None:
        return Options(capture, workspace, given.choice, name, last=not given.choose)
    assert scene is not None
    if run.words != "no options":
        print(f"{scene.name}: the last run had {run.words}", file=sys.stderr)
    device = _usable(run.choice.device) if given.choice.device == "auto" else given.choice.device
    return Options(capture, workspace, replace(run.choice, device=device, time=None), scene.name, last=True)


def _usable(device: str) -> str:
    """The device of a run if this machine has it: its results may be looked at on any other."""
    if device != "auto":
        with suppress(SettingsError):
            resolve_device(device)
            return device
    return "auto"


def scene_or_capture(path: Path, workspace: Path, name: str | None = None) -> tuple[Path, str | None, Path]:
    """The capture, the scene's name (None: the capture's own) and the workspace that ``path`` means: the folder of a scene, a capture, or
    the name of a scene in ``workspace``. ``name`` is the value of --name. Raises SettingsError for a scene's folder in another workspace
    than ``workspace``, unless that is the default."""
    path = path.expanduser()
    folder = path if owner_of(path) is not None else _named(path, workspace)
    owner = None if folder is None else owner_of(folder)
    if folder is None or owner is None:
        return path, name, workspace
    places = {Path(os.path.abspath(folder)).parent.parent.resolve(), (own := folder.resolve().parent.parent)}
    if workspace != DEFAULT_WORKSPACE and workspace.resolve() not in places:
        raise SettingsError(f"--workspace {workspace}: {path} is a scene of {own}; give --workspace {own}, or the capture itself")
    return Path(owner), name or folder.resolve().name, own


def _named(path: Path, workspace: Path) -> Path | None:
    """The folder of the scene with the name ``path`` in ``workspace``. None if there is none, or ``path`` may be a capture: an empty folder
    is none, and hides no scene."""
    if path.exists() and not (path.is_dir() and not any(path.iterdir())):
        return None
    folder = workspace / "scenes" / composed(str(path))
    return folder if len(path.parts) == 1 and owner_of(folder) is not None else None


def _absent(capture: Path, name: str | None, workspace: Path) -> str:
    if name is not None:
        return (
            f"the scene {name} was made from {capture}, which is not there any more; put the capture back, its pictures are needed, "
            f"or name the place that it was moved to, with --name {name}"
        )
    known = [folder.name for folder in scenes_in(workspace)[:20]]
    scenes = f"; its scenes are {', '.join(known)}" if known else ""
    return f"{capture}: no such file or folder, and no scene of {workspace} has that name{scenes}"


def scene_of(path: Path, workspace: Path, stage: str | None = None) -> str | None:
    """The name of the scene that ``path`` means: its folder, its name, or its capture, of which the scene that ran last (with ``stage``) is
    taken. None if there is none."""
    capture, name, _ = scene_or_capture(path, workspace)
    if name is None and (found := _newest(scenes_of(capture, workspace), stage)) is not None:
        name = found.name
    return name


def _scene(given: Given, stage: str) -> Path | None:
    """The folder of the scene that is meant; None if there is none yet."""
    if given.name is not None:
        folder = given.workspace / "scenes" / given.name
        return None if owner_of(folder) is None else folder
    assert given.capture is not None
    capture, name, workspace = scene_or_capture(given.capture, given.workspace)
    return workspace / "scenes" / name if name is not None else _newest(scenes_of(capture, workspace), stage)


def _newest(scenes: Sequence[Path], stage: str | None) -> Path | None:
    """The scene that ran last, among those with a run that included ``stage`` if there is one."""
    known = {scene: run for scene in scenes if (run := last_run(scene, stage)) is not None}
    known = known or {scene: run for scene in scenes if (run := last_run(scene)) is not None}
    if known:
        return max(known, key=lambda scene: known[scene].began)
    return scenes[0] if len(scenes) == 1 else None
