"""What stages of a batch share on one machine: one at a time on the GPU, memory within a cap, cores divided."""

import itertools
import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from e4dgs.pipeline import Resources
from e4dgs.workflows.batch.ledger import Ledger, SceneState
from e4dgs.workflows.batch.listing import Entry
from e4dgs.workflows.batch.local import Local
from e4dgs.workflows.batch.process import run_process
from e4dgs.workflows.batch.share import Share, usual_memory_gb
from e4dgs.workflows.batch.work import PARTS
from PIL import Image


class Crowd:
    """Threads that each take a share for a moment, and who had one at the same time."""

    def __init__(self, share: Share) -> None:
        self.share, self.now, self.together = share, set(), []
        self._threads: list[threading.Thread] = []

    def add(self, name: str, wanted: Resources, release: threading.Event | None = None) -> None:
        def run() -> None:
            with self.share.take(wanted, 1):
                self.now.add(name)
                self.together.append(set(self.now))
                release.wait(10) if release else time.sleep(0.05)
                self.now.discard(name)

        self._threads.append(threading.Thread(target=run))
        self._threads[-1].start()

    def ends(self) -> None:
        for thread in self._threads:
            thread.join(20)


def share(memory_gb: float = 8.0, cores: int = 4) -> Share:
    return Share(cores, memory_gb, lambda: False)


def test_one_stage_at_a_time_has_the_gpu_and_others_overlap_with_it():
    crowd, done = Crowd(share()), threading.Event()
    crowd.add("gpu0", Resources(gpu=True), done)
    crowd.add("gpu1", Resources(gpu=True))
    crowd.add("cpu", Resources())
    time.sleep(0.3)
    done.set()
    crowd.ends()
    assert {"gpu0", "cpu"} in crowd.together and not any({"gpu0", "gpu1"} <= found for found in crowd.together)
    assert any("gpu1" in found for found in crowd.together)


def test_stages_that_want_the_same_are_told_apart():
    both = share()
    with both.take(Resources(), 2) as first:
        with both.take(Resources(), 2):
            pass  # ends while both leases hold the same figures
        assert first.too_large(20.0), "the one that still runs is the one that takes too much"


def test_memory_that_stages_say_they_take_stays_within_the_cap():
    crowd = Crowd(share(memory_gb=4.0))
    for k in range(6):
        crowd.add(f"stage{k}", Resources(memory_gb=1.9))
    crowd.ends()
    assert len(crowd.together) == 6 and max(map(len, crowd.together)) == 2


def test_a_stage_that_wants_more_than_there_is_runs_alone_and_is_not_overtaken():
    crowd, done = Crowd(share(memory_gb=4.0)), threading.Event()
    crowd.add("small0", Resources(memory_gb=1.0), done)
    time.sleep(0.1)
    crowd.add("large", Resources(memory_gb=40.0))
    time.sleep(0.1)
    crowd.add("small1", Resources(memory_gb=1.0))
    time.sleep(0.1)
    assert crowd.now == {"small0"}, "who came later does not take the place"
    done.set()
    crowd.ends()
    assert crowd.together == [{"small0"}, {"large"}, {"small1"}]


def test_cores_are_divided_among_the_scenes_at_work():
    one = share(cores=8)
    for scenes, wanted, threads in ((1, None, 8), (2, None, 4), (3, None, 2), (20, None, 1), (2, 3, 3), (2, 6, 4)):
        with one.take(Resources(cores=wanted), scenes) as lease:
            assert lease.threads == threads


def test_the_stage_that_takes_most_above_what_it_said_has_to_go():
    one = share(memory_gb=4.0)
    with one.take(Resources(memory_gb=2.0), 2) as honest, one.take(Resources(memory_gb=0.5), 2) as greedy:
        assert not honest.too_large(2.1) and not greedy.too_large(1.5), "3.6 of 4"
        assert "4.1 GB" in greedy.too_large(2.0) and not honest.too_large(2.1)


def test_a_batch_that_is_stopped_lets_nobody_wait():
    stopped = threading.Event()
    one = Share(1, 1.0, stopped.is_set)
    crowd = Crowd(one)
    with one.take(Resources(gpu=True), 1):
        crowd.add("waits", Resources(gpu=True))
        stopped.set()
        crowd.ends()
    assert crowd.together == [{"waits"}]


def test_the_machine_has_memory():
    assert 0.1 < usual_memory_gb() < 1e5


# -- a stage's process


def started(words: list[str], log: Path):
    """What starts a process that adds what it prints to ``log``."""

    def start() -> subprocess.Popen:
        with open(log, "ab") as output:
            return subprocess.Popen(words, stdout=output, start_new_session=True)

    return start


def test_a_process_that_hangs_is_ended_though_it_will_not_hear(tmp_path, monkeypatch):
    monkeypatch.setattr("e4dgs.workflows.batch.process.GRACE", 0.5)
    script = tmp_path / "deaf"
    script.write_text("#!/bin/sh\ntrap '' TERM\necho begins\nsleep 600 & wait\nsleep 600\n")
    script.chmod(0o755)
    log = tmp_path / "log.txt"
    ended = run_process(started([str(script)], log), log, 1.0, lambda used: "", lambda: False)
    assert ended.code is None and "--stage-timeout" in ended.problem and not ended.memory and ended.seconds < 60
    assert log.read_text() == "begins\n"


def test_a_process_that_takes_too_much_is_ended_whatever_it_is_told(tmp_path, monkeypatch):
    monkeypatch.setattr("e4dgs.workflows.batch.process.LOOK_AT_MEMORY", 0.0)
    log = tmp_path / "log.txt"
    ended = run_process(started(["sleep", "60"], log), log, 60.0, lambda used: "ended after it took 9 GB", lambda: False)
    assert ended.code is None and ended.memory and ended.problem == "ended after it took 9 GB"


def test_a_process_that_ends_by_itself_meanwhile_is_no_error(tmp_path):
    """The server of a fork waits for it, so its group may be gone although the last poll said that it runs."""

    class Reaped:
        def __init__(self) -> None:
            with subprocess.Popen(["true"], start_new_session=True) as process:
                self.pid = process.pid

        def poll(self) -> None:
            return None

        def wait(self, timeout: float | None = None) -> int:
            if timeout is not None:
                raise subprocess.TimeoutExpired("true", timeout)
            return 0

    assert run_process(Reaped, tmp_path / "log.txt", None, lambda used: "", lambda: True).code is None


def test_a_failed_process_is_explained_by_its_own_last_words(tmp_path):
    log = tmp_path / "log.txt"
    log.write_text("error: of an earlier stage\n")
    words = [sys.executable, "-S", "-c", "print('one'); print('error: no disk'); print('two'); raise SystemExit(1)"]
    assert run_process(started(words, log), log, None, lambda used: "", lambda: False).problem == "no disk"
    words[-1] = "print('a'); raise SystemExit(3)"
    assert run_process(started(words, log), log, None, lambda used: "", lambda: False).problem.startswith("a")


# -- whole batches of toy stages, each in a process of its own


@pytest.fixture
def batch(tmp_path):
    """Runs a batch of three captures, the second of which is the victim; returns its ledger and exit code."""
    for k, name in enumerate(("first", "victim", "third")):
        (tmp_path / name).mkdir()
        for i in range(3):
            Image.new("RGB", (32, 24), (40 * i, 30 * k, 0)).save(tmp_path / name / f"{i}.png")

    def run(*words: str) -> tuple[Ledger, int]:
        toys = str(Path(__file__).parent / "toy_site")
        path = os.pathsep.join([toys, *filter(None, [os.environ.get("PYTHONPATH")])])
        captures = [str(tmp_path / name) for name in ("first", "victim", "third")]
        command = [sys.executable, "-m", "e4dgs.workflows.cli", "batch", *captures, "--workspace", str(tmp_path / "work"), *words]
        done = subprocess.run(command, env=dict(os.environ, PYTHONPATH=path), capture_output=True, timeout=250)
        return Ledger(tmp_path / "work", "batch"), done.returncode

    return run


@pytest.mark.parametrize(("fails", "states"), [(1, ["done", "done"]), (2, ["failed", "done"])])
def test_a_scene_that_meets_an_error_nobody_expects_is_tried_again_and_then_says_so(tmp_path, monkeypatch, fails, states):
    ledger = Ledger.create(tmp_path, "batch", [Entry("first", "/captures/first"), Entry("second", "/captures/second")])
    left = {"first": fails}

    def run_part(workspace, batch, scene, part, *more, **named):
        if left.get(scene, 0):
            left[scene] -= 1
            raise OSError(12, "Cannot allocate memory")
        ledger.write(scene, SceneState("done" if part == PARTS[-1] else "waiting"))
        return True

    monkeypatch.setattr("e4dgs.workflows.batch.local.run_part", run_part)
    local = Local(ledger, jobs=2, memory_gb=1.0, retries=1, timeout=None)
    ends = [future.result(20) for future in local.start(ledger.entries())]
    local.stop()
    found = [ledger.progress(name) for name in ("first", "second")]
    assert [progress.state for progress in found] == states and ends == [state == "done" for state in states]
    assert states[0] == "done" or "Cannot allocate memory" in found[0].message


@pytest.mark.parametrize(
    ("act", "words", "said"),
    [
        ("crash", (), "SIGSEGV"),
        ("killed", (), "SIGKILL; out of memory, perhaps"),
        ("eat", ("--memory", "0.5"), "--memory"),
        ("eat", ("--executor", "cluster.yaml"), "memory_gb"),
    ],
)
def test_what_goes_wrong_in_a_stage_fails_that_stage_with_a_message_and_nothing_else(batch, tmp_path, act, words, said):
    if "--executor" in words:
        pytest.importorskip("parsl")
        (tmp_path / "cluster.yaml").write_text("retries: 0\ncpu: {cores: 1, memory_gb: 0.5}\n")
        words = ("--executor", str(tmp_path / "cluster.yaml"))
    else:
        words = ("--retries", "0", *words)
    ledger, code = batch("--set", f"coarse.act={act}", "--set", "coarse.victim=victim", *words)
    assert code == 1
    states = {entry.name: ledger.progress(entry.name) for entry in ledger.entries()}
    assert {name: progress.state for name, progress in states.items()} == {"first": "done", "victim": "failed", "third": "done"}
    assert states["victim"].stage == "coarse" and said in states["victim"].message


def test_stages_on_the_gpu_take_turns_in_a_batch(batch, tmp_path):
    ledger, code = batch("--jobs", "3", "--set", "coarse.gpu=true", "--set", "coarse.seconds=0.2")
    assert code == 0
    spans = []
    for entry in ledger.entries():
        lines = [line.split() for line in (tmp_path / "events" / f"{entry.name}.txt").read_text().splitlines()]
        of_stage = [float(words[0]) for words in lines if words[1] == "coarse"]
        spans.append((of_stage[0], of_stage[-1]))
    spans.sort()
    assert all(end <= begin for (_, end), (begin, _) in itertools.pairwise(spans))
