"""`e4dgs.load`: the model of a finished run, for a script."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from ..pipeline import ArtifactError, Records, Store
from ..pipeline.files import read_json
from .last_run import Run, last_run
from .machine.devices import resolve_device
from .results import run_command
from .scenes import scenes_of
from .session import DEFAULT_WORKSPACE, Options
from .which_scene import scene_or_capture

if TYPE_CHECKING:
    from ..scene.model import Model


def load(path: str | Path, workspace: str | Path = DEFAULT_WORKSPACE, device: str = "auto") -> Model:
    """The model of the last run of a scene, ready for `Model.render`.

    Args:
        path: a scene's folder (``<workspace>/scenes/<name>``) or its name, or a capture that has been run in ``workspace``.
        workspace: the workspace in which to look up a capture or a name.
        device: "auto", "cpu" or "cuda".

    Raises ArtifactError if there is no finished model. The message says where it was looked for and which command makes one.
    """
    scene = _scene_folder(Path(path).expanduser(), Path(workspace).expanduser())
    records, store = Records(scene / "records"), Store(scene.parent.parent / "store")
    plan = read_json(scene / "plan.json")
    skipped = {row["stage"] for row in plan.get("stages", ()) if row.get("state") == "skip"} if isinstance(plan, dict) else set()
    for stage in ("fine", "coarse"):
        record = records.read(stage)
        if record is None or stage in skipped:
            continue
        if store.has(stage, record["key"]):
            from ..stages.shared.model import read_model

            return read_model(store.open(stage, record["key"])).to(resolve_device(device))
    raise ArtifactError(f"{scene}: no finished model of this scene is in {store.root}; make one with: {_command(scene)}")


def _scene_folder(path: Path, workspace: Path) -> Path:
    """``path`` itself if it is a scene's folder, the scene of that name, or the only scene that was made from the capture ``path``."""
    _, name, place = scene_or_capture(path, workspace)
    if name is not None:
        return (place / "scenes" / name).resolve()
    found = scenes_of(path, workspace)
    if len(found) == 1:
        return found[0].resolve()
    if found:
        names = ", ".join(folder.name for folder in found)
        raise ArtifactError(f"{path}: {workspace} has several scenes of this capture ({names}); give the folder of one, {found[0]}")
    if not path.exists():
        raise ArtifactError(f"{path}: there is no such file or folder, and no scene of this name in {workspace}; name its workspace")
    raise ArtifactError(
        f"{path}: this is not the folder of a scene, and {workspace} has no scene of such a capture; "
        f"make one with: {run_command(Options(path, workspace), 'all')}, or name its workspace"
    )


def _command(scene: Path) -> str:
    """The command that makes the model of this scene, with the options of its last run."""
    (capture, name, workspace), run = scene_or_capture(scene, scene.parent.parent), last_run(scene) or Run()
    return run_command(Options(capture, workspace, replace(run.choice, time=None), name), "all")
