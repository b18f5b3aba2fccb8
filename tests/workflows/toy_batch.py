"""Batches of toy scenes that can be held in the middle of their training: what several tests of lost workers share."""

import os
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import psutil
from e4dgs.workflows.batch.ledger import Ledger
from PIL import Image

PATIENCE = 400.0  # s; on an idle machine none of what is waited for takes a tenth of it


def wait(condition: Callable[[], object], seconds: float, what: str) -> None:
    until = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < until, f"not within {seconds:.0f} s: {what}"
        time.sleep(0.2)


class ToyBatch:
    """Captures, a workspace, and what a head is started with. words: further ones of `e4dgs batch`. environment: of the head."""

    def __init__(self, folder: Path, scenes: Sequence[str], steps: int, words: Sequence[str], environment: Mapping[str, str]) -> None:
        self.folder, self.scenes, self.steps, self.words = folder, scenes, steps, words
        toys = Path(__file__).parent / "toy_site"
        path = os.pathsep.join([str(toys), *filter(None, [os.environ.get("PYTHONPATH")])])
        self.environment = {**environment, "PYTHONPATH": path}
        for k, name in enumerate(scenes):
            (folder / name).mkdir()
            for i in range(3):
                Image.new("RGB", (32, 24), (40 * i, 20 * k, 0)).save(folder / name / f"{i}.png")
        rows = [f"{{capture: {name}, settings: {{coarse.iterations: {steps}}}}}" for name in scenes]
        (folder / "scenes.yaml").write_text("\n".join(f"- {row}" for row in rows))
        self.ledger = Ledger(folder / "work", "batch")

    def start(self, *words: str) -> subprocess.Popen:
        """A head, which writes to `head.txt`."""
        command = [sys.executable, "-m", "e4dgs.workflows.cli", "batch", str(self.folder / "scenes.yaml"), *self.words, *words]
        with open(self.folder / "head.txt", "ab") as output:
            return subprocess.Popen(
                [*command, "--workspace", str(self.folder / "work")], env=self.environment, stdout=output, stderr=output
            )

    def said(self) -> str:
        return (self.folder / "head.txt").read_text()

    def events(self, scene: str, what: str) -> int:
        """How often a stage has told it."""
        file = self.folder / "events" / f"{scene}.txt"
        return file.read_text().count(what) if file.is_file() else 0

    def hold(self, *scenes: str) -> None:
        """Their training stays at half of its steps until they are released."""
        (self.folder / "events").mkdir(exist_ok=True)
        for scene in scenes:
            (self.folder / "events" / f"{scene}.hold").touch()

    def release(self, *scenes: str) -> None:
        for scene in scenes:
            (self.folder / "events" / f"{scene}.hold").unlink()

    def trains(self, scene: str, time: int = 1) -> None:
        """Waits until a scene is in the middle of its training, which has begun ``time`` times."""
        wait(lambda: self.events(scene, "coarse begin") >= time, PATIENCE, f"{scene} has begun to train {time} times")
        wait(lambda: self.events(scene, "coarse step") >= self.steps // 2, PATIENCE, f"{scene} trains")

    def processes(self, *words: str) -> list[psutil.Process]:
        """That have this batch's folder and all of ``words`` in their command line."""
        found = []
        for process in psutil.process_iter(["cmdline"]):
            line = " ".join(process.info["cmdline"] or []).split()  # a fork says all of it in one word
            if any(str(self.folder) in word for word in line) and all(word in line for word in words):
                found.append(process)
        return found

    def states(self) -> Counter:
        return Counter(self.ledger.shown(name).state for name in self.scenes)

    def check(self) -> None:
        """All scenes are done, no stage was made twice, and no step before a checkpoint was done again."""
        assert self.states() == {"done": len(self.scenes)}, [self.ledger.progress(name) for name in self.scenes]
        for name in self.scenes:
            said = self.ledger.log(name).read_text()
            for stage in ("frames", "coarse", "evaluate"):  # a line that follows publication
                assert said.count(f"{stage}: done in") <= 1, f"{name}: {stage} was made twice"
            again = self.events(name, "coarse step") - self.steps
            assert 0 <= again < self.events(name, "coarse begin"), f"{name}: steps before the checkpoint were done again"
