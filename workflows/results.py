"""Results of a capture in the store, found by the options of the run that made them."""

from __future__ import annotations

import shlex

from ..pipeline import Artifact, ArtifactError, CaptureError, make_plan
from .session import DEFAULT_WORKSPACE, Options, Session


def results(session: Session, stage: str) -> dict[str, Artifact | None]:
    """The stored results of ``stage`` and the stages it needs, by name; None for stages that this capture skips.

    Raises CaptureError if ``stage`` itself is skipped, ArtifactError if it has not been run with these settings.
    """
    rows = {row.stage: row for row in make_plan(session.job, [stage])}
    wanted, capture = rows[stage], session.options.capture
    if wanted.state == "skip":
        raise CaptureError(f"{capture}: this capture has no {stage}: {wanted.reason}")
    if wanted.state == "run":
        raise ArtifactError(
            f"{capture}: the workspace {session.options.workspace} has no {stage} of this capture with these settings ({wanted.reason}); "
            f"make it with: {run_command(session.options, stage)}"
        )
    return {name: row.artifact for name, row in rows.items()}


def run_command(options: Options, stage: str) -> str:
    """The command that runs ``stage`` with the same options, ready to paste into a shell."""
    return shlex.join(["e4dgs", "run", stage, *words_of(options)])


def words_of(options: Options) -> list[str]:
    """The capture and the options as words of a command line, without options that have their default."""
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
    """The stage that makes the final model with these settings: `fine`, or `coarse` if `fine` is skipped."""
    return "coarse" if any(row.stage == "fine" and row.state == "skip" for row in make_plan(session.job)) else "fine"
