"""`e4dgs report`: draws the page of a finished run again, from the store alone."""

from __future__ import annotations

from rich.console import Console

from ..pipeline import make_plan
from .machine.writable import writing_to
from .options import Capture, Debug, Device, Format, Name, Preset, Set, Static, Workspace
from .reconstruction import EVALUATION
from .results import results
from .runs import execute
from .session import DEFAULT_WORKSPACE, Options, open_session


def report(
    capture: Capture,
    workspace: Workspace = DEFAULT_WORKSPACE,
    preset: Preset = "default",
    set: Set = None,
    device: Device = "auto",
    name: Name = None,
    static: Static = False,
    format: Format = None,
    debug: Debug = False,
) -> None:
    """Write metrics.json and report.html of a finished run again, and say where they are. Give the options of the run."""
    session = open_session(Options(capture, workspace, preset, set or (), device, name, static, format))
    results(session, EVALUATION)  # raises an error that names the missing command if the run is not finished
    console = Console()
    with writing_to(workspace.resolve()):
        (session.scene.folder / "records" / "report-shows.json").unlink(missing_ok=True)
        found = execute(session, make_plan(session.job), console, lambda line: None)
    assert found is not None
    console.print(str(found[1]), markup=False, highlight=False, soft_wrap=True)
