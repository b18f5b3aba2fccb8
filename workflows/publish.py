"""Writes the results of a run for people and programs: plan.json, metrics.json, report.html and player.html in the scene's folder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..pipeline import Artifact, Outcome, Row
from ..pipeline.files import read_json, write_atomically, write_json
from ..stages.evaluate.artifact import has_player, read_metrics, read_player
from ..stages.seeds.artifact import read_seeds_png
from ..stages.shared.report_attributes import report_attributes
from ..stages.shared.training_log import read_training_log
from .reconstruction import EVALUATION, TRAINING
from .results import completed, run_command
from .session import Session

PLAYER = "player.html"  # in a scene's folder


def plan_json(session: Session, rows: Sequence[Row]) -> dict[str, Any]:
    """The plan as JSON: the scene, what was recognised, and one row per stage."""
    job, choice = session.job, session.options.choice
    return {
        "scene": session.scene.name,
        "capture": str(session.scene.capture),
        "recognised": dict(job.capture.facts),
        "notes": list(session.notes),
        "device": job.device,
        "preset": choice.preset,
        **({"time": choice.time, "decided": list(choice.resolved)} if choice.time else {}),
        "settings": {name: settings.model_dump(mode="json") for name, settings in job.settings.items()},
        "stages": [row.as_json() for row in rows],
    }


def write_plan(session: Session, rows: Sequence[Row]) -> Path:
    """Writes ``scenes/<name>/plan.json``: what the run planned to do."""
    path = session.scene.folder / "plan.json"
    content = plan_json(session, rows)
    if read_json(path) != content:
        write_json(path, content)
    return path


def metrics_json(scene: str, outcomes: Mapping[str, Outcome]) -> dict[str, Any]:
    """metrics.json: what `evaluate` measured, the training time, and the outcome of every stage.

    Times and memory of a cached stage are those of the run that made it. If a training was resumed, its time is the total in its own log,
    since the last process ran only a part of it.
    """
    evaluate = outcomes[EVALUATION].artifact
    assert evaluate is not None
    return {
        **read_metrics(evaluate),
        "scene": scene,
        "train_seconds": round(sum(_training_seconds(outcomes[name]) for name in TRAINING if name in outcomes), 1),
        "stages": {name: outcome.as_json() for name, outcome in outcomes.items()},
    }


def _training_seconds(outcome: Outcome) -> float:
    if outcome.artifact is None:
        return 0.0
    return max(outcome.seconds, float(read_training_log(outcome.artifact).get("seconds", 0.0)))


def publish(session: Session, rows: Sequence[Row], outcomes: Sequence[Outcome]) -> tuple[dict[str, Any], Path]:
    """Writes metrics.json, report.html and, where the report has the scene in it, player.html with the scene alone; returns the metrics and
    the report's path. The pages are drawn again only if a stage ran or the results in them have changed.
    """
    from .. import __version__

    named = {outcome.stage: outcome for outcome in outcomes}
    evaluate = named[EVALUATION].artifact
    assert evaluate is not None
    folder = session.scene.folder
    metrics = metrics_json(session.scene.name, named)
    metrics["splits"] = {split: _completed(values, session) for split, values in metrics["splits"].items()}
    if read_json(folder / "metrics.json") != metrics:
        write_json(folder / "metrics.json", metrics)
    report = folder / "report.html"
    shown = {"version": __version__, "artifacts": {name: o.artifact.digest for name, o in named.items() if o.artifact}}
    stamp = folder / "records" / "report-shows.json"
    there = report.is_file() and ((folder / PLAYER).is_file() or not has_player(evaluate))
    if any(outcome.state == "ran" for outcome in outcomes) or not there or read_json(stamp) != shown:
        player = _player(session.scene.name, evaluate)
        write_atomically(report, _render(session, rows, named, evaluate, metrics, player))
        if player is None:
            (folder / PLAYER).unlink(missing_ok=True)
        else:
            write_atomically(folder / PLAYER, player)
        write_json(stamp, shown)
    return metrics, report


def _completed(values: Mapping[str, Any], session: Session) -> Mapping[str, Any]:
    """The values of a split, with the options of this run in the command that would add LPIPS."""
    reason = values.get("lpips_reason")
    return values if reason is None else {**values, "lpips_reason": completed(reason, session.options)}


def _player(scene: str, evaluate: Artifact) -> str | None:
    """The page on which the scene plays; None if `evaluate` holds no scene for it."""
    from ..scene.formats.web.container import header_of
    from .player.page import page

    stored = read_player(evaluate)
    return None if stored is None else page(scene, *stored, header_of(stored[0])[0]["background"], play=False)


def _render(
    session: Session,
    rows: Sequence[Row],
    outcomes: Mapping[str, Outcome],
    evaluate: Artifact,
    metrics: Mapping[str, Any],
    player: str | None,
) -> str:
    from ..stages.report.page import render_report

    infos = {name: report_attributes(outcome.artifact) for name, outcome in outcomes.items() if outcome.artifact is not None}
    for info in infos.values():
        info["log"] = [completed(line, session.options) for line in info["log"]]
    plan_rows = [{**row.as_json(), **outcomes[row.stage].as_json(), "planned": row.state} for row in rows]
    placed = outcomes["seeds"].artifact if "seeds" in outcomes else None
    seeds = None if placed is None else read_seeds_png(placed)
    return render_report(session.scene.name, evaluate, infos, plan_rows, metrics, seeds, run_command(session.options, "all"), player)
