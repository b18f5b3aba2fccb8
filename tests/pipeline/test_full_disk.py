"""A full disk ends a run with one message that has path and bytes; nothing half-written stays, and the rerun succeeds."""

import errno
import os
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest
import toy_stages
from e4dgs.pipeline import Runner, Settings, Stage, StageError, Store
from e4dgs.pipeline.storage.room import NoRoomError, said_when_full
from failing import FailNth
from small_disk import small_disk
from toy_stages import Bench, Numbers

MEGABYTE = 1 << 20


class NoiseSettings(Settings):
    kilobytes: int = 64


class Noise(Stage):
    """Writes so many kilobytes, which no compressor makes smaller, and a checkpoint before."""

    name = "noise"
    inputs = ("numbers",)
    settings = NoiseSettings

    def run(self, ctx):
        toy_stages.note(ctx, self.name)
        (ctx.checkpoints / "state").write_text("begun")
        noise = np.random.default_rng(0).integers(0, 256, (ctx.settings.kilobytes, 1024), dtype=np.uint8)
        ctx.out.create("noise", noise.shape, noise.dtype, (32, 1024))[...] = noise


@pytest.fixture
def disk(tmp_path):
    with small_disk(tmp_path / "disk", 4 * MEGABYTE) as mounted:
        yield mounted


@pytest.fixture
def bench(disk) -> Bench:
    """A capture and a workspace on the small disk."""
    return Bench.create(disk.path)


def job(bench: Bench, kilobytes: int = 64):
    return bench.job(Numbers(), Noise(), noise__kilobytes=str(kilobytes))


def left_in_tmp(bench: Bench) -> list:
    return list((bench.store.root / "tmp").glob("*"))


def test_it_is_said_with_path_and_bytes_and_the_rerun_succeeds(bench, disk):
    with pytest.raises(NoRoomError) as caught:
        Runner(job(bench, 6000)).run()
    said = re.fullmatch(
        r"noise: (\S+): No space left on device: (\d+) bytes were written; (\d+) bytes are free in (\S+)(; \d+ bytes are free in \S+)?\. "
        r"Make room there .*",
        str(caught.value),
    )
    assert said is not None, str(caught.value)
    assert said[1].startswith(str(disk.path)) and said[4].startswith(str(disk.path)) and "\n" not in str(caught.value)
    assert int(said[2]) > 3 * MEGABYTE and int(said[3]) < MEGABYTE // 4, "as it was when it was full"
    assert not left_in_tmp(bench) and [stage for stage, _ in bench.store.entries()] == ["numbers"]
    found = os.statvfs(disk.path)
    assert found.f_bavail * found.f_frsize > 3 * MEGABYTE, "what was written for nothing is gone"
    disk.resize(size=16 * MEGABYTE)
    assert [outcome.state for outcome in Runner(job(bench, 6000)).run()] == ["cached", "ran"]
    assert not any(problem for _, _, problem in bench.store.verify())


def test_however_little_is_free_the_run_ends_well_or_says_so(bench, disk):
    """From nothing to all that it takes, three pages more each time."""
    fresh = set(bench.root.iterdir())
    refused = 0
    for pages in range(0, 150, 3):
        filler = disk.fill(4096 * pages)
        try:
            Runner(job(bench)).run()
        except NoRoomError as error:
            refused += 1
            assert str(disk.path) in str(error) and re.search(r"\d+ bytes are free in ", str(error)), error
            assert not left_in_tmp(bench)
            filler.unlink()
        else:
            filler.unlink()
            break
        finally:
            assert not any(problem for _, _, problem in bench.store.verify())
        assert [outcome.artifact.digest != "" for outcome in Runner(job(bench)).run()] == [True, True]
        assert not any(problem for _, _, problem in bench.store.verify())
        for place in set(bench.root.iterdir()) - fresh:
            shutil.rmtree(place) if place.is_dir() else place.unlink()
    assert 6 < refused < 49


def test_a_disk_with_room_but_no_more_files_is_said_too(bench, disk):
    used = os.statvfs(disk.path)
    refused = 0
    for more in range(1, 60):
        disk.resize(nr_inodes=used.f_files - used.f_ffree + more)
        try:
            Runner(job(bench)).run()
            break
        except NoRoomError as error:
            refused += 1
            assert re.search(r"bytes and \d more files are free in ", str(error)), error
        assert not left_in_tmp(bench)
    assert refused > 5 and not any(problem for _, _, problem in bench.store.verify())


def test_what_is_taken_from_another_store_says_what_it_needs(bench, disk, tmp_path):
    """Between two file systems it is copied, so it takes room."""
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    theirs = Bench.create(elsewhere)
    size = sum(file[0] for file in Runner(job(theirs)).run()[1].artifact.manifest["files"].values())
    ours = replace(job(bench), also=[Store(theirs.store.root)])
    filler = disk.fill(48 * 1024)
    with pytest.raises(NoRoomError, match=rf"noise, taken from {theirs.store.root}: {disk.path}\S*: No space left.*: {size} are needed; "):
        Runner(ours).run()
    assert not left_in_tmp(bench)
    filler.unlink()
    bench.runs()
    assert [outcome.state for outcome in Runner(ours).run()] == ["cached", "cached"] and bench.runs() == []
    assert not any(problem for _, _, problem in bench.store.verify())


class Alone(Noise):
    inputs = ()


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT], ids=["disk", "quota"])
def test_room_may_end_at_any_call(quick_folder, number):
    """A user's quota has no small disk to be tried on, so every call is refused in turn."""
    bench = Bench.create(quick_folder)
    words = os.strerror(number)
    for n in range(1, 300):
        shutil.rmtree(bench.root / "workspace", ignore_errors=True)
        error = None
        with FailNth(n, OSError(number, words), quick_folder).patched() as failure:
            try:
                Runner(bench.job(Alone())).run()
            except StageError as caught:
                error = caught
        if error is not None:
            assert isinstance(error, NoRoomError) and f": {words}: " in str(error) and str(quick_folder) in str(error), error
        if not failure.failed:
            break
        assert Runner(bench.job(Alone())).run()[0].artifact is not None
        assert not any(problem for _, _, problem in bench.store.verify()) and not left_in_tmp(bench)
    assert 25 < n < 299


class Wordy(Stage):
    """Writes with a library that has errors of its own."""

    name = "wordy"

    def run(self, ctx):
        raise RuntimeError("I/O error: No space left on device (os error 28)")


def test_a_librarys_own_words_are_understood(tmp_path):
    with pytest.raises(NoRoomError, match=r"^wordy: \S+: No space left on device: 0 bytes were written; \d+ bytes are free in "):
        Runner(Bench.create(tmp_path).job(Wordy())).run()


def test_other_errors_pass_as_they_are(tmp_path):
    for error in (OSError(errno.EIO, "Input/output error"), StageError("frame 3: no luck")):
        with pytest.raises(type(error)) as caught, said_when_full(tmp_path):
            raise error
        assert caught.value is error
