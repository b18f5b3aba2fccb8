"""`e4dgs export WHAT CAPTURE`: results of the store as files that other programs read. Nothing is computed that a stage computes."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from ..pipeline import Artifact, ArtifactError, CaptureError, Progress, SettingsError, StageError, make_plan
from .options import Capture, Debug, Device, Format, Name, Preset, Set, Static, Workspace
from .session import DEFAULT_WORKSPACE, Options, Session, open_session

app = typer.Typer(no_args_is_help=True, help="Write results as files for other programs.")

Out = Annotated[Path | None, typer.Option("--out", metavar="DIR", help="Where to; scenes/<name>/export/flow in the workspace by default.")]
Largest = Annotated[float | None, typer.Option("--largest", metavar="PX", help="Motion that gets full colour; chosen by default.")]


@app.command()
def flow(
    capture: Capture,
    out: Out = None,
    largest: Largest = None,
    workspace: Workspace = DEFAULT_WORKSPACE,
    preset: Preset = "default",
    set: Set = None,
    device: Device = "auto",
    name: Name = None,
    static: Static = False,
    format: Format = None,
    debug: Debug = False,
) -> None:
    """Measured flow of every pair of frames as .flo and PNG, with edges and what moves laid over the first frame."""
    if largest is not None and not 0 < largest < float("inf"):
        raise SettingsError(f"--largest {largest}: give a positive number of px")
    if out is not None and out.exists() and not out.is_dir():
        raise SettingsError(f"--out {out}: this is a file; name a folder")
    session = open_session(Options(capture, workspace, preset, set or (), device, name, static, format))
    found = results(session, "flow")
    artifact, frames = found["flow"], found["frames"]
    assert artifact is not None and frames is not None  # `results` has seen to the first, and no stage runs without the second
    folder = out
    if folder is None:
        session.scene.claim()
        folder = session.scene.folder / "export" / "flow"

    from ..stages.flow_export import common_largest, export_flow
    from ..stages.flow_fields import FlowFields
    from ..stages.frameset import FrameSet

    console = Console()
    fields = FlowFields(artifact)
    if not fields.pairs:
        why = artifact.attrs.get("static_reason", "no two training frames of one camera")
        raise CaptureError(f"{capture}: no flow was measured, so there is none to export: {why}")
    largest = largest or common_largest(fields)
    pictures = FrameSet(frames, session.job.capture.root, found.get("poses"))
    try:
        with Progress(len(fields.pairs), "export", console) as bar:
            count = export_flow(fields, pictures, folder, largest, bar.advance)
    except OSError as error:
        raise StageError(f"export: {error.filename or folder} cannot be written ({error.strerror or error}); give another --out") from error
    for line in (
        f"{len(fields.pairs)} pairs, {count} files; full colour is {largest:.3g} px, darker is more, black is not known (wheel.png)",
        f"flow: {folder}",
    ):
        console.print(line, markup=False, highlight=False, soft_wrap=True)


def results(session: Session, stage: str) -> dict[str, Artifact | None]:
    """What the store has of ``stage`` and the stages it needs, by name; None for those that this capture skips.

    Raises CaptureError where ``stage`` itself is skipped, ArtifactError where it has still to be run with these settings.
    """
    rows = {row.stage: row for row in make_plan(session.job, [stage])}
    wanted, capture = rows[stage], session.options.capture
    if wanted.state == "skip":
        raise CaptureError(f"{capture}: there is no {stage} to export: {wanted.reason}")
    if wanted.state == "run":
        raise ArtifactError(
            f"{capture}: the workspace {session.options.workspace} has no {stage} of this capture with these settings ({wanted.reason}); "
            f"make it with: {run_command(session.options, stage)}"
        )
    return {name: row.artifact for name, row in rows.items()}


def run_command(options: Options, stage: str) -> str:
    """The command that runs ``stage`` with the same options, ready to be pasted into a shell."""
    words = ["e4dgs", "run", stage, str(options.capture)]
    for flag, value, default in (
        ("--workspace", str(options.workspace), str(DEFAULT_WORKSPACE)),
        ("--preset", options.preset, "default"),
        ("--device", options.device, "auto"),
        ("--name", options.name, None),
        ("--format", options.format, None),
    ):
        words += [flag, str(value)] if value != default else []
    words += ["--static"] if options.static else []
    for assignment in options.assignments:
        words += ["--set", assignment]
    return shlex.join(words)
