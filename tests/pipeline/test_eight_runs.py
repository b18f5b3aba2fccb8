"""Eight runs of one capture at a time, killed at random: each result is made once, and again only where its maker was killed."""

import json
import subprocess
import sys
from collections import Counter
from pathlib import Path

import eight_runs
import pytest
from e4dgs.pipeline import Runner

STAGES = ("first", "second", "third")


@pytest.fixture
def bench(quick_folder) -> eight_runs.toy_stages.Bench:
    return eight_runs.toy_stages.Bench.create(quick_folder)


def run(bench, seed: int, kills: int, *words: str) -> dict:
    command = [sys.executable, str(Path(eight_runs.__file__)), str(bench.root), str(seed), str(kills), *words]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return json.loads(done.stdout)


def job(bench):
    return bench.job(eight_runs.First(), eight_runs.Second(), eight_runs.Third())


@pytest.mark.parametrize(("seed", "kills"), [(0, 0), (1, 12), (2, 25)])
def test_each_result_is_made_once_by_a_run_that_lives(bench, seed, kills):
    found = run(bench, seed, kills)
    assert len(found["killed"]) == kills and not any(found["codes"]) and not found["errors"], found
    for stage in STAGES:
        makers = [process for name, process in found["calls"] if name == stage]
        assert makers and len([process for process in makers if process not in found["killed"]]) <= 1, (stage, found)
        assert max(Counter(makers).values()) == 1, "no run makes a result twice"
        assert len({(key, digest) for name, key, digest in found["results"] if name == stage}) == 1
    nothing_is_left(bench)
    assert [outcome.state for outcome in Runner(job(bench)).run()] == ["cached"] * 3


def nothing_is_left(bench) -> None:
    assert sorted(stage for stage, _ in bench.store.entries()) == sorted(STAGES)
    assert not any(problem for _, _, problem in bench.store.verify())
    for path in (bench.store.root / "locks").iterdir():
        with bench.store.lock_if_free(*path.stem.split("-")) as free:
            assert free, f"{path.name} is still locked"
    bench.store.sweep()
    assert not list((bench.store.root / "tmp").iterdir())
    assert not list((bench.store.root / "checkpoints").iterdir())


def test_without_locks_runs_may_fail_and_results_stay_right(bench):
    """What locks are relied on for: not for right results, but for runs that do not spoil one another's work."""
    found = run(bench, 3, 0, "unlocked")
    assert set(found["codes"]) <= {0, 1} and len(found["errors"]) == found["codes"].count(1), found
    for stage in STAGES:
        assert len({digest for name, _, digest in found["results"] if name == stage}) <= 1
    assert not any(problem for _, _, problem in bench.store.verify())
    assert len(Runner(job(bench)).run()) == 3
    nothing_is_left(bench)
