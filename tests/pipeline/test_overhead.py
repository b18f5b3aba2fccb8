"""What the engine costs beside the files that it has to touch: few calls, no search through the store, a small factor of time."""

import os
import shutil
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from blake3 import blake3
from e4dgs.pipeline import Runner, make_plan

CALLS: Counter[str] | None = None


COUNTED = ("open", "os.scandir", "os.listdir", "os.rename", "os.mkdir")


def count(event: str, arguments: tuple) -> None:
    if CALLS is not None and event in COUNTED and "numbers.txt" not in str(arguments[:1]):
        CALLS[event] += 1


sys.addaudithook(count)  # for as long as the process lives; it counts only inside `calls`


@contextmanager
def calls() -> Iterator[Counter[str]]:
    """Counts what is opened, listed, moved and made."""
    global CALLS
    CALLS = Counter()
    try:
        yield CALLS
    finally:
        CALLS = None


def fill(bench, results: int) -> None:
    """Other results of the same stages."""
    for stage, key in bench.store.entries():
        for k in range(results):
            shutil.copytree(bench.store.path(stage, key), bench.store.path(stage, f"{k:032x}"))


@pytest.mark.parametrize("what", ["plan", "run"])
def test_a_cached_stage_takes_few_calls_however_much_is_in_the_store(bench, what):
    def cached() -> None:
        if what == "plan":
            assert {row.state for row in make_plan(bench.job())} == {"cached"}
        else:
            assert {outcome.state for outcome in Runner(bench.job()).run()} == {"cached"}

    bench.run()
    cached()
    with calls() as before:
        cached()
    fill(bench, 50)
    with calls() as after:
        cached()
    assert after == before
    # A stage, beside the capture: its record and its manifest are opened, its three folders listed; a run also reads its JSON files.
    assert 4 < before["open"] <= 4 * (2 if what == "plan" else 8) and before["os.scandir"] <= 4 * 4
    assert before["os.rename"] == before["os.mkdir"] == 0, "what is cached writes nothing"


def quickest(*contenders: Callable[[], None], rounds: int = 15) -> list[float]:
    """The best time of each, in turns, so that what else the machine does hits all alike."""
    best = [float("inf")] * len(contenders)
    for _ in range(rounds):
        for k, contender in enumerate(contenders):
            started = time.perf_counter()
            contender()
            best[k] = min(best[k], time.perf_counter() - started)
    return best


def files_of(bench) -> list[Path]:
    return [path for entry in bench.store.entries() for path in bench.store.path(*entry).rglob("*") if path.is_file()]


def test_planning_takes_a_small_multiple_of_reading_the_files(bench):
    """Measured 4.6 times; threads for small files alone made it 35 times."""
    bench.run()
    files, job = files_of(bench), bench.job()
    assert job.capture_digest

    def read() -> None:
        for path in files:
            blake3(path.read_bytes()).hexdigest()

    planned, plain = quickest(lambda: make_plan(job) and None, read)
    assert planned < 15 * plain, f"{planned * 1e3:.2f} ms for four stages, {plain * 1e3:.2f} ms for reading their files"


def test_running_takes_a_small_multiple_of_writing_the_files(bench, tmp_path):
    """The plain way: the same files written and synced, and the folder moved into place. Measured 1.5 to 1.8 times, most
    of both is the disk's; where syncing costs nothing 50 ms are allowed."""
    bench.run()
    (key,) = [key for stage, key in bench.store.entries() if stage == "numbers"]
    source = bench.store.path("numbers", key)
    contents = {path.relative_to(source): path.read_bytes() for path in source.rglob("*") if path.is_file()}

    def write() -> None:
        target = tmp_path / "plain"
        for name, data in contents.items():
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            with open(target / name, "wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
        os.rename(target, tmp_path / "moved")
        shutil.rmtree(tmp_path / "moved")

    ran, plain = quickest(lambda: Runner(bench.job()).run(["numbers"], force=["numbers"]) and None, write, rounds=8)
    assert ran < 10 * plain + 0.05, f"{ran * 1e3:.1f} ms for a stage, {plain * 1e3:.1f} ms for its files"
