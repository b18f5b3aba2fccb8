"""Measures what it costs to judge a view of the capture."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass

from ...pipeline import Artifact, Job
from ...stages.evaluate.judge import Judge
from ...stages.shared.model import read_model
from ...stages.shared.posed_frameset import PosedFrameSet


@dataclass(frozen=True)
class ViewCosts:
    """Seconds to judge a view, to render it at its size, and to set both up."""

    view: float
    render: float
    setup: float


def measure_views(job: Job, inputs: Mapping[str, Artifact | None], model: Artifact) -> ViewCosts:
    """Judges two views one by one: `evaluate` measures some beside one another and takes no longer."""
    begin = time.perf_counter()
    frames = PosedFrameSet(inputs["frames"], job.capture.root, inputs["poses"])  # type: ignore[arg-type]
    judge = Judge(read_model(model).to(job.device), frames, None, fixed=frames.fixed_cameras)
    chosen = [int(i) for i in frames.train[:: max(1, len(frames.train) // 2)][:2]]
    judge.render(chosen[0])
    setup, judged, rendered = time.perf_counter() - begin, [], []
    for i in (chosen[0], *chosen):
        begin = time.perf_counter()
        judge.measured(i, *judge.render(i))
        judged.append(time.perf_counter() - begin)
        begin = time.perf_counter()
        judge.render(i)
        rendered.append(time.perf_counter() - begin)
    return ViewCosts(sum(judged[1:]) / len(judged[1:]), sum(rendered[1:]) / len(rendered[1:]), setup)
