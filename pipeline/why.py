"""Explains which setting, input or source file of a stage has changed since the stage last ran for a scene."""

from __future__ import annotations

from .job import Job
from .plan import make_plan


def explain(job: Job, stage: str) -> list[str]:
    """Lines for the user: first the stage's own row, then the rows of the stages that it waits for, nearest ones first. Raises
    SettingsError."""
    rows = {row.stage: row for row in make_plan(job, [stage])}
    verb = {"cached": "would be reused", "run": "would run", "skip": "would be skipped"}
    lines = [f"{stage} {verb[rows[stage].state]}: {rows[stage].reason}"]
    pending, seen = list(job.graph[stage].inputs), {stage}
    if rows[stage].state != "run":
        return lines
    while pending:
        name = pending.pop(0)
        if name in seen:
            continue
        seen.add(name)
        if rows[name].state == "run":
            lines.append(f"  {name} would run first: {rows[name].reason}")
            pending.extend(job.graph[name].inputs)
    return lines
