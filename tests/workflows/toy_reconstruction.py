"""A reconstruction of three quick stages on a real capture, for the command line's tests."""

import time
from typing import Any

from e4dgs.pipeline import Applies, CaptureError, Graph, Settings, Stage, StageError
from e4dgs.stages.frames.settings import FramesSettings
from pydantic import Field


class Frames(Stage):
    name = "frames"
    settings = FramesSettings
    reads_capture = True

    def run(self, ctx: Any) -> None:
        if "broken" in ctx.capture.name:
            raise CaptureError("000.png: cut short; copy it again")
        for note in ctx.capture.notes:  # as the real stage does
            ctx.log(note)
        ctx.out.attrs["frames"] = ctx.facts["frames"]


class FineSettings(Settings):
    iterations: int = Field(10, ge=0, le=100, description="steps")


class Fine(Stage):
    name = "fine"
    inputs = ("frames",)
    settings = FineSettings

    def applies(self, facts: Any, settings: FineSettings) -> Applies:
        return Applies.yes() if settings.iterations else Applies.no("fine.iterations is 0")

    def run(self, ctx: Any) -> None:
        if ctx.settings.iterations == 13:
            raise StageError("fine: 13 steps bring bad luck; choose another number")
        if ctx.settings.iterations == 14:
            raise MemoryError("out of memory")
        time.sleep(0.002)  # at a millisecond's rounding, some time passes
        ctx.out.attrs["steps"] = ctx.settings.iterations
        ctx.out.info["training"] = {"seconds": 1234.0}
        ctx.log("all steps done" if ctx.settings.iterations != 15 else "all steps done; e4dgs export web CAPTURE writes a page")
        if ctx.settings.iterations == 16:
            raise StageError("fine: the flow is damaged; make it again with `e4dgs run flow CAPTURE --force`, or see e4dgs store list")


class Evaluate(Stage):
    name = "evaluate"
    inputs = ("frames", "fine")

    def run(self, ctx: Any) -> None:
        fine = ctx.inputs["fine"]
        psnr = 20.0 + fine.attrs["steps"] if fine is not None else 10.0
        test = {"psnr": psnr, "lpips": None, "lpips_reason": "no weights; then: e4dgs run evaluate CAPTURE --force"}
        ctx.out.attrs["metrics"] = {"protocol": {"split": "test"}, "splits": {"test": test}, "primitives": {}}
        ctx.out.info["metrics"] = {"render_fps": 12.5}


def toy_reconstruction() -> Graph:
    return Graph([Frames(), Fine(), Evaluate()])


def render_report(scene: str, evaluate: Any, infos: Any, plan_rows: Any, metrics: Any, *more: Any) -> str:
    rows = "".join(f"<li>{row['stage']} {row['planned']} {row['state']}</li>" for row in plan_rows)
    return f"<html>{scene} {metrics['splits']} {infos.get('fine', {}).get('log')} {rows}</html>"
