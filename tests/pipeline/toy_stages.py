"""numbers -> scaled, clipped -> total, and `slow`, which counts with checkpoints. Every run is written down in ``<root>/runs.log``."""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from e4dgs.pipeline import Applies, CaptureError, Graph, Job, Records, Runner, Settings, Stage, StageError, Store, build_settings
from pydantic import Field


@dataclass
class Capture:
    root: Path
    name: str = "toy"
    files: tuple[str, ...] = ("numbers.txt",)

    @property
    def facts(self) -> dict[str, Any]:
        return {"count": len((self.root / "numbers.txt").read_text().split())}


def note(ctx: Any, name: str) -> None:
    with open(ctx.capture.root.parent / "runs.log", "a") as file:
        file.write(name + "\n")


class NumbersSettings(Settings):
    offset: int = Field(0, ge=-10, le=10, description="added to every number")


class Numbers(Stage):
    name = "numbers"
    settings = NumbersSettings
    reads_capture = True

    def run(self, ctx: Any) -> None:
        note(ctx, self.name)
        text = (ctx.capture.root / "numbers.txt").read_text()
        try:
            values = [int(word) for word in text.split()]
        except ValueError:
            raise CaptureError(f"numbers.txt: {text!r} holds a word that is no integer; correct the file") from None
        ctx.out.write("values", np.array(values, np.int64) + ctx.settings.offset, doc="the numbers")
        ctx.out.info["when"] = time.time()


class ScaledSettings(Settings):
    factor: float = Field(2.0, gt=0)
    seed: int = 7


class Scaled(Stage):
    name = "scaled"
    inputs = ("numbers",)
    settings = ScaledSettings
    device_class = True

    def run(self, ctx: Any) -> None:
        note(ctx, self.name)
        ctx.out.write("values", ctx.inputs["numbers"].read("values") * ctx.settings.factor)


class ClippedSettings(Settings):
    limit: int = 2
    skip: bool = False


class Clipped(Stage):
    """Forgets how large its input was: different numbers may give an equal result."""

    name = "clipped"
    inputs = ("numbers",)
    settings = ClippedSettings

    def applies(self, facts: Any, settings: ClippedSettings) -> Applies:
        return Applies.no("clipped.skip is set") if settings.skip else Applies.yes()

    def run(self, ctx: Any) -> None:
        note(ctx, self.name)
        ctx.out.write("values", np.minimum(ctx.inputs["numbers"].read("values"), ctx.settings.limit))


class Total(Stage):
    name = "total"
    inputs = ("clipped",)

    def estimate(self, facts: Any, settings: Settings) -> float:
        return 0.5 * facts["count"]

    def run(self, ctx: Any) -> None:
        note(ctx, self.name)
        clipped = ctx.inputs["clipped"]
        ctx.out.attrs["total"] = int(clipped.read("values").sum()) if clipped is not None else None


class SlowSettings(Settings):
    steps: int = 5
    seconds: float = 0.0
    fail_at: int = -1


class Slow(Stage):
    """Counts to ``steps`` and keeps every step in a checkpoint."""

    name = "slow"
    inputs = ("numbers",)
    settings = SlowSettings

    def run(self, ctx: Any) -> None:
        note(ctx, self.name)
        state = ctx.checkpoints / "step.json"
        start = json.loads(state.read_text()) if state.exists() else 0
        with ctx.progress(ctx.settings.steps, "counting") as bar:
            for step in range(start, ctx.settings.steps):
                time.sleep(ctx.settings.seconds)
                if step == ctx.settings.fail_at:
                    raise ZeroDivisionError("step went wrong")
                (ctx.checkpoints / "new").write_text(str(step + 1))
                os.replace(ctx.checkpoints / "new", state)
                bar.advance()
        ctx.out.write("steps", np.arange(ctx.settings.steps))
        ctx.out.info["started_at"] = start


class Careless(Stage):
    """Creates an array of three chunks and fills one."""

    name = "careless"

    def run(self, ctx: Any) -> None:
        ctx.out.create("part", (6, 4), np.float32, (2, 4))[0:2] = 1


class Failing(Stage):
    name = "failing"

    def run(self, ctx: Any) -> None:
        raise StageError("frame 3: no luck; try another")


@dataclass
class Bench:
    """A capture and a workspace; `job` makes a job with settings, `run` runs it, `runs` says what really ran since the last call."""

    root: Path

    @classmethod
    def create(cls, root: Path) -> Bench:
        (root / "capture").mkdir()
        (root / "capture" / "numbers.txt").write_text("1 2 3")
        return cls(root)

    @property
    def numbers(self) -> Path:
        return self.root / "capture" / "numbers.txt"

    @property
    def store(self) -> Store:
        return Store(self.root / "workspace" / "store")

    def job(self, *stages: Stage, device: str = "cpu", **settings: Any) -> Job:
        graph = Graph(stages or (Numbers(), Scaled(), Clipped(), Total()))
        assignments = [(name.replace("__", "."), value) for name, value in settings.items()]
        built = build_settings(graph.settings, assignments)
        records = Records(self.root / "workspace" / "scenes" / "toy" / "records")
        return Job(graph, Capture(self.root / "capture"), built, self.store, records, device)

    def slow(self, **settings: Any) -> Job:
        return self.job(Numbers(), Slow(), **{f"slow__{name}": value for name, value in settings.items()})

    def run(self, **settings: Any) -> dict[str, str]:
        """States of all stages after a run with these settings."""
        return {outcome.stage: outcome.state for outcome in Runner(self.job(**settings)).run()}

    def runs(self) -> list[str]:
        path = self.root / "runs.log"
        lines = path.read_text().split() if path.exists() else []
        path.unlink(missing_ok=True)
        return lines


if __name__ == "__main__":  # python toy_stages.py ROOT STEPS SECONDS: runs `slow` in a process of its own
    signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored where the tests run in a shell's background
    bench = Bench(Path(sys.argv[1]))
    print([outcome.state for outcome in Runner(bench.slow(steps=sys.argv[2], seconds=sys.argv[3])).run()])
