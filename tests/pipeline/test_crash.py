"""Whatever fails, wherever it fails: a result is there whole or not at all, and the next run ends well."""

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
import toy_stages
from e4dgs.pipeline import Artifact, Runner, StageError, Store, make_plan
from failing import Crash, FailNth

SCRIPT = [sys.executable, str(Path(toy_stages.__file__))]


@pytest.fixture
def bench(quick_folder) -> toy_stages.Bench:
    return toy_stages.Bench.create(quick_folder)


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), Crash()], ids=["error", "crash"])
@pytest.mark.parametrize("forced", [False, True], ids=["new", "replaced"])
def test_failing_at_any_write_leaves_all_or_nothing(bench, error, forced):
    stages = ["numbers"]
    whole = Runner(bench.job()).run(stages)[0].artifact
    digest, key = whole.digest, whole.path.name
    del whole  # who holds an artifact keeps it from being removed
    for n in range(1, 200):
        assert forced or bench.store.take("numbers", key, "tmp")
        with FailNth(n, error, bench.root).patched() as failure, contextlib.suppress(StageError, OSError, Crash):
            Runner(bench.job()).run(stages, force=stages if forced else ())
        found = bench.store.has("numbers", key)
        if forced and not isinstance(error, Crash):
            assert found, "an error while a result is replaced leaves the old one or the new one"
        if found:
            artifact = Artifact(bench.store.path("numbers", key))
            artifact.verify()
            assert artifact.digest == digest
            del artifact
        assert make_plan(bench.job(), stages)[0].state == ("cached" if found else "run")
        assert Runner(bench.job()).run(stages)[0].artifact.digest == digest
        if not failure.failed:
            break
    assert n > 10, "the loop must have failed at many places before it got through"
    bench.store.sweep()
    assert list((bench.store.root / "tmp").iterdir()) == []


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), Crash()], ids=["error", "crash"])
def test_failing_while_damage_is_set_aside_leaves_the_damaged_or_a_whole_result(bench, error):
    path = Runner(bench.job()).run(["clipped"])[0].artifact.path
    chunk = path / "values" / "c" / "0"
    for n in range(1, 200):
        data = bytearray(chunk.read_bytes())
        data[5] ^= 1
        chunk.write_bytes(data)
        with FailNth(n, error, bench.root).patched() as failure, contextlib.suppress(StageError, OSError, Crash):
            Runner(bench.job(clipped__limit=100 + n)).run(["clipped"])
        made = Runner(bench.job(clipped__limit=100 + n)).run(["clipped"])[1].artifact
        assert made.read("values").tolist() == [1, 2, 3]
        assert not any(problem for _, _, problem in bench.store.verify())
        if not failure.failed:
            break
        key = made.path.name
        del made  # who holds an artifact keeps it from being removed
        assert bench.store.take("clipped", key, "tmp"), "or each round would verify the results of all before it once more"
    assert n > 10, "the loop must have failed at many places before it got through"


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), Crash()], ids=["error", "crash"])
def test_failing_while_a_result_is_taken_over_leaves_all_or_nothing(bench, error):
    Runner(bench.job()).run(["numbers"])
    theirs = Store(bench.root / "theirs")
    os.rename(bench.store.root, theirs.root)
    bench.runs()
    for n in range(1, 200):
        shutil.rmtree(bench.store.root, ignore_errors=True)
        with FailNth(n, error, bench.root).patched() as failure, contextlib.suppress(StageError, OSError, Crash):
            Runner(replace(bench.job(), also=[theirs])).run(["numbers"])
        assert not any(problem for _, _, problem in bench.store.verify())
        assert Runner(replace(bench.job(), also=[theirs])).run(["numbers"])[0].artifact.read("values").tolist() == [1, 2, 3]
        assert bench.runs() == [] and theirs.problem(*theirs.entries()[0]) == ""
        if not failure.failed:
            break
    assert n > 5, "the loop must have failed at many places before it got through"


def start(bench, steps: int, seconds: float) -> subprocess.Popen:
    return subprocess.Popen([*SCRIPT, str(bench.root), str(steps), str(seconds)], stdout=subprocess.PIPE, text=True)


def wait_for_step(bench, step: int) -> None:
    for _ in range(1500):
        for path in (bench.store.root / "checkpoints").glob("slow-*/step.json"):
            if int(path.read_text()) >= step:
                return
        time.sleep(0.02)
    raise AssertionError("the process never got to its checkpoint")


def test_a_killed_stage_is_never_taken_for_done_and_continues(bench):
    process = start(bench, 60, 0.05)
    wait_for_step(bench, 5)
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    assert [stage for stage, _ in bench.store.entries()] == ["numbers"]
    assert len(list((bench.store.root / "tmp").iterdir())) == 1, "the dead run could not clean up"
    job = bench.slow(steps=60)
    job.settings["slow"] = job.settings["slow"].model_copy(update={"seconds": 0.05})  # the killed run's settings
    row = make_plan(job)[1]
    assert row.state == "run" and row.reason == "never run for this scene; continues from a checkpoint"
    assert row.continues
    made = Runner(job).run()[1].artifact
    assert made.info["started_at"] >= 5
    assert made.read("steps").tolist() == list(range(60))
    assert list((bench.store.root / "tmp").iterdir()) == [] == list((bench.store.root / "checkpoints").iterdir())


def test_other_settings_do_not_continue_from_that_checkpoint(bench):
    with pytest.raises(StageError):
        Runner(bench.slow(steps=5, fail_at=3)).run()
    assert Runner(bench.slow(steps=5)).run()[1].artifact.info["started_at"] == 0


def test_force_starts_over_instead_of_continuing(bench):
    with pytest.raises(StageError):
        Runner(bench.slow(fail_at=3)).run()
    path = next((bench.store.root / "checkpoints").glob("slow-*/step.json"))
    path.write_text("4")  # who continues from here never comes to the step that fails
    with pytest.raises(StageError):
        Runner(bench.slow(fail_at=3)).run(force=["slow"])
    path.write_text("4")
    assert Runner(bench.slow(fail_at=3)).run()[1].artifact.info["started_at"] == 4


def test_an_interrupted_run_leaves_a_clean_state(bench):
    process = start(bench, 200, 0.05)
    wait_for_step(bench, 2)
    process.send_signal(signal.SIGINT)
    process.wait(timeout=20)
    assert process.returncode != 0
    assert list((bench.store.root / "tmp").iterdir()) == []
    assert [stage for stage, _ in bench.store.entries()] == ["numbers"]
    assert len(list((bench.store.root / "checkpoints").iterdir())) == 1


def test_two_processes_make_one_result_once(bench):
    processes = [start(bench, 10, 0.1) for _ in range(2)]
    output = [process.communicate(timeout=60)[0].strip() for process in processes]
    assert [process.returncode for process in processes] == [0, 0]
    assert sorted(bench.runs()) == ["numbers", "slow"], "each stage ran once"
    assert sorted(output) != ["['ran', 'ran']"] * 2


def test_sweeping_spares_what_a_living_process_builds(bench):
    process = start(bench, 200, 0.05)
    wait_for_step(bench, 1)
    left = bench.store.root / "tmp" / "slow-0123-dead"
    left.mkdir()
    assert bench.store.sweep() == ["slow-0123-dead"]
    assert len(list((bench.store.root / "tmp").iterdir())) == 1
    process.kill()
    process.wait()
    assert len(bench.store.sweep()) == 1
