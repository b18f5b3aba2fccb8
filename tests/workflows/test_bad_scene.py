"""One bad scene of ten: nine finish, and the table names the tenth, its stage, its message and the command that runs it again."""

import csv
import os
import shlex
import subprocess
import sys

from toy_batch import PATIENCE, ToyBatch

SCENES = [f"scene{k}" for k in range(10)]
BAD = "scene6"


def test_one_bad_scene_of_ten(tmp_path):
    words = ["--jobs", "2", "--retries", "0", "--set", "coarse.act=leave", "--set", f"coarse.victim={BAD}"]
    batch = ToyBatch(tmp_path, SCENES, 1, words, os.environ)
    assert batch.start().wait(PATIENCE) == 1
    assert batch.states() == {"done": 9, "failed": 1}
    with open(batch.ledger.folder / "results.csv", newline="") as file:
        rows = {row["scene"]: row for row in csv.DictReader(file)}
    bad = rows[BAD]
    assert (bad["state"], bad["stage"]) == ("failed", "coarse") and "there is no act leave" in bad["message"]
    page = (batch.ledger.folder / "results.html").read_text()
    assert page.index(f">{BAD}<") < min(page.index(f">{name}<") for name in SCENES if name != BAD), "the worst first"
    assert page.count(bad["command"]) == 1 and rows["scene0"]["command"] not in page
    assert f"{BAD}: failed coarse: " in batch.said() and bad["command"] in batch.said()

    program, *rest = shlex.split(bad["command"])
    assert program == "e4dgs"
    again = subprocess.run([sys.executable, "-m", "e4dgs.workflows.cli", *rest], env=batch.environment, capture_output=True, text=True)
    assert again.returncode == 1 and "there is no act leave" in again.stderr
    mended = [word.replace("coarse.act=leave", "coarse.act=") for word in rest]
    assert subprocess.run([sys.executable, "-m", "e4dgs.workflows.cli", *mended], env=batch.environment).returncode == 0
    assert batch.events(BAD, "frames begin") == 1, "what was done before it failed is not done again"
