"""What the command line prints about captures, plans and results."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from ..pipeline import Row, counted, duration, say, settings_by_name
from ..pipeline.errors import one_line
from ..stages.facts import Facts
from ..stages.poses.artifact import read_limits
from .session import SEEDS, Session

_COLOURS = {"cached": "green", "run": "yellow", "skip": "dim"}


def show_capture(console: Console, session: Session) -> None:
    """Prints what was recognised and why, and which parts of the capture were left out or assumed."""
    facts = Facts.of(session.job.capture.facts)
    splits = ", ".join(f"{count} {name}" for name, count in facts.splits.items() if count)
    console.print(f"[bold]{escape(session.scene.name)}[/]: {facts.format} ({escape(facts.why)})", soft_wrap=True, highlight=False)
    seen = f"{counted(facts.cameras, 'camera')}, {counted(facts.times, 'time')}"
    say(f"  {counted(facts.frames, 'frame')} {facts.width}x{facts.height}, {seen}; {splits}", to=console)
    holdout = getattr(session.job.settings.get("frames"), "holdout", 0)
    if facts.frames < holdout and facts.every_time == 1 and not (facts.splits.get("test") or facts.splits.get("val")):
        say(
            f"  {counted(facts.frames, 'picture')}, fewer than frames.holdout={holdout}: all train, and none is held out for testing",
            to=console,
        )
    say(*(f"  {one_line(note)}" for note in session.notes), to=console)
    if session.scene.notice is not None:
        say(f"  {session.scene.notice}", to=console)


def show_plan(console: Console, rows: Sequence[Row], session: Session) -> None:
    """Prints one line per stage: state, estimate, what it does and why; settings that change nothing; with --time, what the run is expected
    to take."""
    time = session.options.choice.time
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for title in ("stage", "state", "estimate", "reason"):
        table.add_column(title, no_wrap=title != "reason", overflow="fold")
    for row in rows:
        estimate = f"about {duration(row.estimate)}" if row.estimate is not None else ""
        words = f"{row.task} ({row.reason})" if row.state == "run" and row.task else row.reason
        table.add_row(row.stage, f"[{_COLOURS[row.state]}]{row.state}[/]", estimate, escape(words))
    console.print(table)
    for row in rows:
        if row.stage == "poses" and row.artifact is not None and (limits := read_limits(row.artifact)):
            say(f"{row.stage}: {limits}", to=console)
    say(*without_effect(rows, session), to=console)
    if time is not None and (left := [row.estimate for row in rows if row.state == "run" and row.estimate is not None]):
        console.print(f"expected: about {duration(sum(left))} of {time}; each stage is decided when it begins, by what is left")


def without_effect(rows: Sequence[Row], session: Session) -> list[str]:
    """A line for each setting of --set that only stages have which are skipped for another reason."""
    skipped = {row.stage: row.reason for row in rows if row.state == "skip"}
    known, lines = settings_by_name(session.job.graph.settings), []
    for text in session.options.choice.set:
        name = text.partition("=")[0].strip()
        stages = known[name][0] if name in known and name not in SEEDS else []
        reasons = [skipped.get(stage) for stage in stages]
        if reasons and all(reason is not None and name not in reason for reason in reasons):
            lines.append(
                f"{name} changes nothing here: {' and '.join(stages)} {'is' if len(stages) == 1 else 'are'} skipped ({reasons[0]})"
            )
    return lines


def show_metrics(console: Console, metrics: Mapping[str, Any], report: Path) -> None:
    """Prints the numbers of metrics.json that people look for first, and the path of the report."""
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for title in ("split", "PSNR", "SSIM", "LPIPS", "edge PSNR"):
        table.add_column(title)
    for split, values in metrics.get("splits", {}).items():
        cells = [_number(values.get(name), digits) for name, digits in (("psnr", 2), ("ssim", 4), ("lpips", 4), ("edge_psnr", 2))]
        table.add_row(split, *cells)
    console.print(table)
    parts = [f"trained in {duration(metrics['train_seconds'])}"]
    if metrics.get("render_fps") is not None:
        parts.append(f"{metrics['render_fps']:.1f} frames per second")
    if primitives := metrics.get("primitives"):
        parts.append(
            f"{counted(primitives.get('gaussians', 0), 'Gaussian')}, {counted(primitives.get('convexes', 0), 'convex', 'convexes')}"
        )
    console.print(", ".join(parts), highlight=False)
    say(f"report: {report}", to=console)


def _number(value: Any, digits: int) -> str:
    return f"{value:.{digits}f}" if isinstance(value, int | float) else "-"
