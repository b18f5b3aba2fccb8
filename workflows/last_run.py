"""The runs of a scene: which options each had, and which run a command means that is given no options.

``scenes/<name>/runs.json`` lists them, oldest first.
"""

from __future__ import annotations

import os
import shlex
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

from ..pipeline import ArtifactError, CaptureError, SettingsError
from ..pipeline.files import canonical_json, digest_bytes, read_json, write_json
from ..pipeline.names import composed
from .machine.devices import resolve_device
from .reconstruction import reconstruction
from .scenes import CLAIM
from .session import DEFAULT_WORKSPACE, NO_CHOICE, Choice, Options, Session

FILE = "runs.json"
KEPT = 50  # runs of a scene that the file lists at most


@dataclass(frozen=True)
class Run:
    """One run: its target ("all" or a stage), the options that chose its results, when it began (seconds since 1970), and whether it came
    to its end."""

    target: str = "all"
    choice: Choice = NO_CHOICE
    began: float = 0.0
    done: bool = False
    facts: str = ""  # digest of the capture's facts that settings were decided for

    @property
    def words(self) -> str:
        """The options as on a command line, without the device and those that have their default; "no options" for none."""
        return shlex.join(replace(self.choice, device="auto", time=None).words()) or "no options"


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


def remember(session: Session, target: str, began: float, done: bool = False) -> None:
    """Adds a run to the scene's list, in place of earlier ones with the same target and options."""
    options, file = session.options, session.scene.folder / FILE
    run = Run(target, options.choice, round(began, 3), done, facts_of(session) if options.choice.time else "")
    earlier = runs_of(session.scene.folder)
    if any(one.done and _same(one) == _same(run) for one in earlier):
        run = replace(run, done=True)  # its results are there, also while it runs again
    others = [one for one in earlier if _same(one) != _same(run) and one.began != run.began]  # a run decides settings as it goes
    with suppress(OSError):  # a workspace that can only be read
        write_json(file, {"runs": [_row(one) for one in (*others, run)][-KEPT:]})


def runs_of(scene: Path) -> list[Run]:
    """The runs of the scene in this folder, oldest first; [] if none is known."""
    content = read_json(scene / FILE)
    rows = content.get("runs") if isinstance(content, dict) else None
    return sorted((run for row in rows or () if (run := _run(row)) is not None), key=lambda run: run.began)


def _same(run: Run) -> Run:
    return replace(run, began=0.0, done=False)


def facts_of(session: Session) -> str:
    """A digest of what is known of a capture before anything runs. With other facts, what was decided for a time does not hold."""
    return digest_bytes(canonical_json(dict(session.job.capture.facts)))[:16]


def decided_for(options: Options) -> Run | None:
    """The run whose settings were decided for the same capture, time and options; None if there is none."""
    named = [] if options.name is None else [options.workspace / "scenes" / options.name]
    scenes = named or scenes_of(options.capture, options.workspace)
    known = [run for scene in scenes for run in runs_of(scene) if run.choice.resolved]
    runs = [run for run in known if replace(run.choice, resolved=()) == replace(options.choice, resolved=())]
    return max(runs, key=lambda run: run.began, default=None)


def last_run(scene: Path, stage: str | None = None, done: bool = True) -> Run | None:
    """The last run of a scene that included ``stage``, or any stage if that is None; None if there was none. done: one that has come to its
    end, if there is any."""
    graph = reconstruction()

    def includes(run: Run) -> bool:
        if stage is None or run.target == "all":
            return True
        return run.target in graph.stages and stage in {one.name for one in graph.needed_for([run.target])}

    found = [run for run in reversed(runs_of(scene)) if includes(run)]
    return next((run for run in found if run.done or not done), found[0] if found else None)


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
    folder = path if is_scene(path) else _named(path, workspace)
    if folder is None:
        return path, name, workspace
    places = {Path(os.path.abspath(folder)).parent.parent.resolve(), (own := folder.resolve().parent.parent)}
    if workspace != DEFAULT_WORKSPACE and workspace.resolve() not in places:
        raise SettingsError(f"--workspace {workspace}: {path} is a scene of {own}; give --workspace {own}, or the capture itself")
    claim = read_json(folder / CLAIM)
    return Path(claim["path"]), name or folder.resolve().name, own  # type: ignore[index]


def _named(path: Path, workspace: Path) -> Path | None:
    """The folder of the scene with the name ``path`` in ``workspace``. None if there is none, or ``path`` may be a capture: an empty folder
    is none, and hides no scene."""
    if path.exists() and not (path.is_dir() and not any(path.iterdir())):
        return None
    folder = workspace / "scenes" / composed(str(path))
    return folder if len(path.parts) == 1 and is_scene(folder) else None


def is_scene(folder: Path) -> bool:
    """Whether this is the folder of a scene, with the name of its capture."""
    claim = read_json(folder / CLAIM)
    return isinstance(claim, dict) and isinstance(claim.get("path"), str)


def _absent(capture: Path, name: str | None, workspace: Path) -> str:
    if name is not None:
        return (
            f"the scene {name} was made from {capture}, which is not there any more; put the capture back, its pictures are needed, "
            f"or name the place that it was moved to, with --name {name}"
        )
    known = sorted(claim.parent.name for claim in (workspace / "scenes").glob(f"*/{CLAIM}"))
    scenes = f"; its scenes are {', '.join(known[:20])}" if known else ""
    return f"{capture}: no such file or folder, and no scene of {workspace} has that name{scenes}"


def scenes_of(capture: Path, workspace: Path) -> list[Path]:
    """Folders of all scenes of ``workspace`` that were made from this capture."""
    path = str(Path(os.path.abspath(capture.expanduser())).resolve())
    claims = sorted((workspace / "scenes").glob(f"*/{CLAIM}"))
    return [claim.parent for claim in claims if (read_json(claim) or {}).get("path") == path]


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
        return folder if is_scene(folder) else None
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


def _row(run: Run) -> dict[str, Any]:
    return {name: value for name, value in asdict(run).items() if name != "choice"} | asdict(run.choice)


def _run(row: Any) -> Run | None:
    """A row of the file; None if it is not one of this or an earlier version."""
    if not isinstance(row, Mapping) or not isinstance(row.get("began"), int | float) or not isinstance(row.get("target"), str):
        return None
    own, choice = ({one.name: row[one.name] for one in fields(kind) if one.name in row} for kind in (Run, Choice))
    choice |= {name: tuple(map(str, choice.get(name) or ())) for name in ("set", "resolved")}
    return Run(**{**own, "choice": Choice(**choice)})
