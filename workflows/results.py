"""What the store has of a capture, found by the words that made it."""

from __future__ import annotations

import shlex

from ..pipeline import Artifact, ArtifactError, CaptureError, make_plan
from .session import DEFAULT_WORKSPACE, Options, Session


def results(session: Session, stage: str) -> dict[str, Artifact | None]:
    """What the store has of ``stage`` and the stages it needs, by name; None for those that this capture skips.

    Raises CaptureError where ``stage`` itself is skipped, ArtifactError where it has still to be run with these settings.
    """
    rows = {row.stage: row for row in make_plan(session.job, [stage])}
    wanted, capture = rows[stage], session.options.capture
    if wanted.state == "skip":
        raise CaptureError(f"{capture}: there is no {stage} of it: {wanted.reason}")
    if wanted.state == "run":
        raise ArtifactError(
            f"{capture}: the workspace {session.options.workspace} has no {stage} of this capture with these settings ({wanted.reason}); "
            f"make it with: {run_command(session.options, stage)}"
        )
    return {name: row.artifact for name, row in rows.items()}


def run_command(options: Options, stage: str) -> str:
    """The command that runs ``stage`` with the same options, ready to be pasted into a shell."""
    return shlex.join(["e4dgs", "run", stage, *words_of(options)])


def words_of(options: Options) -> list[str]:
    """The capture and the options as words of a command line, without those that are the default."""
    words = [str(options.capture)]
    for flag, value, default in (
        ("--workspace", str(options.workspace), str(DEFAULT_WORKSPACE)),
        ("--preset", options.preset, "default"),
        ("--device", options.device, "auto"),
        ("--name", options.name, None),
        ("--format", options.format, None),
    ):
        words += [flag, str(value)] if value != default else []
    words += ["--static"] if options.static else []
    for path in options.store_also:
        words += ["--store-also", str(path)]
    for assignment in options.assignments:
        words += ["--set", assignment]
    return words


def trained_stage(session: Session) -> str:
    """The stage whose model counts with these settings: `fine`, or `coarse` where that is skipped."""
    return "coarse" if any(row.stage == "fine" and row.state == "skip" for row in make_plan(session.job)) else "fine"
