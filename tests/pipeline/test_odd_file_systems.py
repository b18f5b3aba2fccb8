"""Clocks that jump, coarse times of change, read-only and shared file systems, and locks as network file systems have them."""

import contextlib
import errno
import fcntl
import os
import shutil
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
import toy_stages
from e4dgs.pipeline import ArtifactError, Runner, StageError, Store, collect, make_plan
from toy_stages import Bench

DAY = 86400.0
ALL = {"numbers", "scaled", "clipped", "total"}
flock = fcntl.flock


@contextlib.contextmanager
def mounted(*words: str, at: Path):
    """``mount`` with these words; skipped where that is not allowed."""
    at.mkdir(exist_ok=True)
    try:
        done = subprocess.run(["mount", *words, str(at)], capture_output=True, text=True)
    except FileNotFoundError:
        pytest.skip("there is no mount command here")
    if done.returncode:
        pytest.skip(f"may not mount here: {done.stderr.strip()}")
    try:
        yield at
    finally:
        subprocess.run(["umount", "--lazy", str(at)], check=True)


def live(bench: Bench, **settings: str) -> set[tuple[str, str]]:
    return {(row.stage, row.key) for row in make_plan(bench.job(**settings)) if row.key is not None}


@pytest.mark.parametrize("jump", [-20000 * DAY, -DAY, DAY, 4000 * DAY], ids=["1971", "yesterday", "tomorrow", "in ten years"])
def test_a_clock_that_jumps_reruns_nothing_and_takes_nothing_that_is_live(bench, monkeypatch, jump):
    real, now = time.time, [0.0]
    monkeypatch.setattr(time, "time", lambda: real() + now[0])
    assert set(bench.run().values()) == {"ran"}
    now[0] = jump
    assert set(bench.run().values()) == {"cached"}
    bench.run(clipped__limit="1")
    now[0] = 0.0
    assert set(bench.run().values()) == {"cached"}
    for limits in ({"older_than": DAY}, {"keep_bytes": 0}, {"keep_bytes": 0, "older_than": DAY}):
        collect(bench.store, lambda: live(bench), **limits)
        assert set(bench.run().values()) == {"cached"}
    assert not any(problem for _, _, problem in bench.store.verify())


def test_a_clock_that_jumps_at_every_look_ends_no_run(bench, monkeypatch):
    real, count = time.time, [0]

    def jumpy() -> float:
        count[0] += 1
        return real() + (-1) ** count[0] * 1000 * DAY

    monkeypatch.setattr(time, "time", jumpy)
    monkeypatch.setattr(time, "gmtime", lambda seconds=None: time.struct_time((1970, 1, 1, 0, 0, 0, 3, 1, 0)))
    path = Runner(bench.job()).run()[0].artifact.path
    (path / "info.json").write_bytes(b"{}")
    assert set(bench.run().values()) == {"ran", "cached"}
    collect(bench.store, lambda: live(bench), older_than=DAY)
    assert set(bench.run().values()) == {"cached"}


def test_changes_within_one_tick_of_the_file_systems_clock_are_seen(bench):
    """Times of change in whole seconds, and files of one size: only the content tells."""
    for numbers in ("1 2 3", "1 2 4", "2 2 4"):
        bench.numbers.write_text(numbers)
        os.utime(bench.numbers, (1000, 1000))
        bench.run()
        assert "numbers" in bench.runs()
    bench.numbers.write_text("1 2 3")
    os.utime(bench.numbers, (1001, 1001))
    bench.run()
    assert bench.runs() == []


def test_what_was_used_within_one_second_goes_in_some_order_and_no_more_than_must(bench):
    for limit in "0123":
        bench.run(clipped__limit=limit)
    for path in bench.store.root.glob("*/*/manifest.json"):
        os.utime(path, (1000, 1000))
    keep = live(bench, clipped__limit="3")
    found = collect(bench.store, lambda: keep, keep_bytes=1)
    assert set(bench.run(clipped__limit="3").values()) == {"cached"} and len(found.removed) == 6
    assert not any(problem for _, _, problem in bench.store.verify())


def test_a_read_only_file_system_gives_its_results_and_refuses_the_rest(bench, tmp_path):
    bench.run()
    bench.runs()
    with mounted("--bind", str(bench.root), at=tmp_path / "read-only") as place:
        subprocess.run(["mount", "-o", "remount,ro,bind", str(place)], check=True)
        there = Bench(place)
        assert {row.state for row in make_plan(there.job())} == {"cached"}
        assert set(there.run().values()) == {"cached"}, "a run that finds everything writes nothing"
        assert Runner(there.job()).run()[2].artifact.read("values").tolist() == [1, 2, 2]
        assert not any(problem for _, _, problem in there.store.verify())
        with pytest.raises(OSError) as caught:
            there.run(clipped__limit="1")
        assert caught.value.errno == errno.EROFS and str(place) in str(caught.value)
        ours = Bench.create(new_folder(tmp_path / "ours"))
        taken = Runner(replace(ours.job(), also=[there.store])).run()
        assert ours.runs() == [] and not any(problem for _, _, problem in ours.store.verify())
        assert taken[2].artifact.path.is_relative_to(ours.root)


def new_folder(path: Path) -> Path:
    path.mkdir()
    return path


def test_a_temporary_folder_on_another_file_system_is_named(bench, tmp_path):
    """``store/tmp`` linked to a scratch disk: nothing can be published in one rename from there."""
    with mounted("-t", "tmpfs", "tmpfs", at=tmp_path / "scratch") as scratch:
        bench.store.root.mkdir(parents=True)
        (bench.store.root / "tmp").symlink_to(scratch)
        with pytest.raises(StageError, match=rf"numbers: its result could not be written to {bench.store.root}/\S+: .*cross-device"):
            Runner(bench.job()).run()
        assert bench.store.entries() == [] and not list(scratch.iterdir())
        (bench.store.root / "tmp").unlink()
        assert set(bench.run().values()) == {"ran"}


def test_two_mounts_of_one_folder_are_one_store(bench, tmp_path):
    """As two machines see a shared store, with the locks of one system: each result is made once, and what one uses the other leaves."""
    words = [sys.executable, str(Path(toy_stages.__file__))]
    with mounted("--bind", str(bench.root), at=tmp_path / "one") as one, mounted("--bind", str(bench.root), at=tmp_path / "two") as two:
        runs = [subprocess.Popen([*words, str(place), "4", "0.1"], stdout=subprocess.DEVNULL) for place in (one, two, one)]
        assert [run.wait(timeout=60) for run in runs] == [0, 0, 0]
        assert sorted(bench.runs()) == ["numbers", "slow"]
        key = next(key for stage, key in bench.store.entries() if stage == "slow")
        held = Bench(one).store.open("slow", key)
        assert [item.stage for item in collect(Bench(two).store, set).busy] == ["slow"]
        assert held.read("steps").tolist() == [0, 1, 2, 3]
        with Bench(one).store.lock("slow", key), Bench(two).store.lock_if_free("slow", key) as free:
            assert not free
        del held
        assert [item.stage for item in collect(Bench(two).store, set).removed] == ["slow"]


def as_nfs(descriptor: int, operation: int) -> None:
    """NFS makes locks on ranges of bytes of these: shared ones want a file open for reading, exclusive ones a file open for writing."""
    mode = fcntl.fcntl(descriptor, fcntl.F_GETFL) & os.O_ACCMODE
    if (operation & fcntl.LOCK_EX and mode == os.O_RDONLY) or (operation & fcntl.LOCK_SH and mode == os.O_WRONLY):
        raise OSError(errno.EBADF, os.strerror(errno.EBADF))
    flock(descriptor, operation)


def test_locks_of_nfs_are_enough(bench, monkeypatch):
    monkeypatch.setattr(fcntl, "flock", as_nfs)
    outcomes = Runner(bench.job()).run()
    bench.run(clipped__limit="1")
    found = collect(bench.store, set)
    assert {item.stage for item in found.busy} == ALL and len(found.removed) == 2, "what is open is held there, too"
    del outcomes
    assert len(collect(bench.store, set).removed) == 4 and bench.store.entries() == []


def test_a_lock_that_another_holds_may_be_refused_in_two_ways(bench, monkeypatch):
    """EAGAIN here, EACCES on some network file systems."""

    def refuse(descriptor: int, operation: int) -> None:
        try:
            flock(descriptor, operation)
        except BlockingIOError:
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES)) from None

    bench.run()
    with bench.store.lock("numbers", "x"):
        held = [bench.store.open(*entry) for entry in bench.store.entries()]
        monkeypatch.setattr(fcntl, "flock", refuse)
        with bench.store.lock_if_free("numbers", "x") as free:
            assert not free
        assert len(collect(bench.store, set).busy) == len(held) == 4


@pytest.mark.parametrize("number", [errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP])
def test_without_locks_results_are_read_and_nothing_is_made_or_removed(bench, monkeypatch, number):
    bench.run()
    entries = bench.store.entries()

    def refuse(descriptor: int, operation: int) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(fcntl, "flock", refuse)
    assert set(bench.run().values()) == {"cached"}
    assert Runner(bench.job()).run()[2].artifact.read("values").tolist() == [1, 2, 2]
    words = rf"^{bench.store.root}/locks/\S+: this file system has no locks \({os.strerror(number)}\).* --workspace on a local disk"
    with pytest.raises(StageError, match=words):
        bench.run(clipped__limit="1")
    with pytest.raises(StageError, match=words):
        collect(bench.store, set)
    assert not bench.store.root.joinpath("clipped", "x").exists() and bench.store.entries() == entries
    there = Bench.create(new_folder(bench.root / "there"))
    monkeypatch.setattr(fcntl, "flock", flock)
    bench.runs()
    Runner(replace(there.job(), also=[bench.store])).run()
    assert there.runs() == []


def test_what_another_machine_removes_while_it_is_read_is_an_error_and_no_zeros(bench):
    """Where locks do not reach the other machine: files go one by one, or another result takes their place."""
    path = Runner(bench.job()).run(["scaled"])[1].artifact.path
    held = Store(bench.store.root).open("scaled", path.name)
    chunk = next((path / "values/c").iterdir())
    content = chunk.read_bytes()
    chunk.unlink()
    with pytest.raises(ArtifactError, match=f"{path}.*'?values"):
        held.read("values")
    chunk.write_bytes(content)
    assert held.read("values").tolist() == [2, 4, 6]
    shutil.copytree(path, bench.root / "other")
    shutil.rmtree(path)
    os.rename(bench.root / "other", path)
    with pytest.raises(ArtifactError, match="another process has replaced"):
        held.read("values")
