"""Three stages that sleep, and tell beside the capture what they have done: `events/<scene>.txt`, a line for each begin, step and end.

Training stays at half of its steps while `events/<scene>.hold` is there, so that a test meets it at work however busy the machine is.
"""

import json
import os
import signal
import sys
import time
from typing import Any

from e4dgs.pipeline import Graph, Resources, Settings, Stage, StageError
from e4dgs.stages.frames.settings import FramesSettings
from pydantic import Field

EVALUATION = "evaluate"
TRAINING = ("coarse",)
LIBRARIES = ()


def tell(ctx: Any, *words: object) -> None:
    folder = ctx.capture.root.parent / "events"
    folder.mkdir(exist_ok=True)
    with open(folder / f"{ctx.capture.name}.txt", "a") as file:
        file.write(" ".join(map(str, (f"{time.time():.3f}", *words))) + "\n")


class Frames(Stage):
    name = "frames"
    settings = FramesSettings
    reads_capture = True

    def run(self, ctx: Any) -> None:
        tell(ctx, "frames begin")
        ctx.out.attrs["of"] = ctx.capture.name
        tell(ctx, "frames end")


class CoarseSettings(Settings):
    iterations: int = Field(4, ge=0, description="steps")
    seconds: float = Field(0.1, ge=0, description="of each step")
    act: str = Field("", description="what goes wrong in the captures named in `victim`")
    victim: str = Field("", description="part of a capture's name")
    fails: bool = Field(False, description="after its last step")
    gpu: bool = Field(False, description="says that it wants the GPU")
    memory_gb: float = Field(0.1, ge=0, description="that it says it takes")


class Coarse(Stage):
    """A step writes a checkpoint; one that was written is not done again."""

    name = "coarse"
    inputs = ("frames",)
    settings = CoarseSettings

    def resources(self, facts: Any, settings: CoarseSettings, device: str) -> Resources:
        return Resources(memory_gb=settings.memory_gb, gpu=settings.gpu)

    def run(self, ctx: Any) -> None:
        from e4dgs.pipeline import thread_count

        tell(ctx, "coarse begin", f"threads={thread_count()}")
        settings, state = ctx.settings, ctx.checkpoints / "step.json"
        hold = ctx.capture.root.parent / "events" / f"{ctx.capture.name}.hold"
        if settings.act and settings.victim in ctx.capture.name:
            self.act(settings.act)
        for step in range(json.loads(state.read_text()) if state.is_file() else 0, settings.iterations):
            time.sleep(settings.seconds)
            while 2 * step >= settings.iterations and hold.exists():
                time.sleep(0.05)
            tell(ctx, "coarse step", step)
            part = state.with_suffix(".part")
            part.write_text(json.dumps(step + 1))
            os.replace(part, state)
        if settings.fails:
            raise StageError("the toy fails, as it was told to")
        ctx.out.attrs["steps"] = settings.iterations
        tell(ctx, "coarse end")

    def act(self, what: str) -> None:
        if what == "crash":
            os.kill(os.getpid(), signal.SIGSEGV)
        if what == "killed":
            os.kill(os.getpid(), signal.SIGKILL)
        if what == "eat":
            kept = bytearray(600 << 20)
            kept[::4096] = bytes([1]) * len(kept[::4096])
            time.sleep(600)
        sys.exit(f"there is no act {what}")


class Evaluate(Stage):
    name = "evaluate"
    inputs = ("frames", "coarse")

    def run(self, ctx: Any) -> None:
        tell(ctx, "evaluate begin")
        ctx.out.attrs["metrics"] = {"protocol": {"split": "test"}, "splits": {"test": {"psnr": 30.0, "lpips": None}}, "primitives": {}}
        ctx.out.info["metrics"] = {"render_fps": 12.5}
        tell(ctx, "evaluate end")


def reconstruction() -> Graph:
    return Graph([Frames(), Coarse(), Evaluate()])


def render_report(scene: str, evaluate: Any, infos: Any, plan_rows: Any, metrics: Any, *more: Any) -> str:
    return f"<html>{scene}</html>"
