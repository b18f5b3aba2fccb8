"""The runs of a scene, and which options each had: ``scenes/<name>/runs.json`` lists them, oldest first."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

from ..pipeline.files import canonical_json, digest_bytes, read_json, write_json
from .reconstruction import reconstruction
from .scenes import scenes_of
from .session import NO_CHOICE, Choice, Options, Session

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


def _row(run: Run) -> dict[str, Any]:
    return {name: value for name, value in asdict(run).items() if name != "choice"} | asdict(run.choice)


def _run(row: Any) -> Run | None:
    """A row of the file; None if it is not one of this or an earlier version."""
    if not isinstance(row, Mapping) or not isinstance(row.get("began"), int | float) or not isinstance(row.get("target"), str):
        return None
    own, choice = ({one.name: row[one.name] for one in fields(kind) if one.name in row} for kind in (Run, Choice))
    choice |= {name: tuple(map(str, choice.get(name) or ())) for name in ("set", "resolved")}
    return Run(**{**own, "choice": Choice(**choice)})
