"""`gc` and what is kept only to save time: unpacked archives and what was heard, by age and size, beside runs that use them."""

import os
import shutil
import subprocess
import sys
import time
import zipfile
from pathlib import Path

import pytest
from e4dgs.workflows.session import Choice, Options, open_session
from e4dgs.workflows.storage.archive import InUse, mark_of, unpacked
from e4dgs.workflows.storage.caches import kept, remove

WORK = Path("e4dgs-workspace")
HOLDS = (
    "import sys\nfrom pathlib import Path\nfrom e4dgs.workflows.session import Choice, Options, open_session\n"
    "session = open_session(Options(Path(sys.argv[1]), Path(sys.argv[2]), Choice(device='cpu')))\nprint('open', flush=True)\n"
    "sys.stdin.read()"
)


def archive(capture: Path, name: str = "scene.zip") -> Path:
    with zipfile.ZipFile(name, "w") as file:
        for path in sorted(capture.iterdir()):
            file.write(path, path.name)
    return Path(name)


def heard(name: str, age: float, size: int = 1000) -> Path:
    place = WORK / "heard" / f"{name}.onsets"
    place.parent.mkdir(parents=True, exist_ok=True)
    place.write_bytes(bytes(size))
    os.utime(place, (time.time() - age, time.time() - age))
    return place


def used(folder: Path, age: float) -> Path:
    os.utime(mark_of(folder), (time.time() - age, time.time() - age))
    return folder


def test_what_is_old_goes_and_is_made_again(cli, capture):
    file = archive(capture)
    assert cli("run", "all", file).code == 0
    (folder,) = (WORK / "unpacked").iterdir()
    old, new = heard("old", 40 * 86400), heard("new", 86400)
    out = cli("gc", "--older-than", "30d").out
    assert "removed heard/old.onsets" in out and not old.exists() and new.exists() and folder.is_dir()
    used(folder, 40 * 86400)
    assert f"would remove unpacked/{folder.name}" in cli("gc", "--older-than", "30d", "--dry-run").out and folder.is_dir()
    assert f"removed unpacked/{folder.name}" in cli("gc", "--older-than", "30d").out and not folder.exists()
    assert "done in" not in cli("run", "all", file).out and folder.is_dir(), "unpacked again, and all results are those from before"
    assert cli("gc").out.count("removed ") == 2 and not folder.exists() and not new.exists()
    assert not list((WORK / "unpacked").iterdir()), "nothing half-removed is left"


def test_use_makes_it_new(cli, capture):
    file = archive(capture)
    cli("plan", file)
    (folder,) = (WORK / "unpacked").iterdir()
    used(folder, 40 * 86400)
    cli("plan", file)
    assert "removed" not in cli("gc", "--older-than", "30d").out and folder.is_dir()


def test_the_size_limit_takes_the_oldest_and_spares_results(cli, capture):
    cli("run", "all", capture)
    cli("run", "all", capture, "--set", "fine.iterations=5")
    results = sum(
        path.stat().st_size for stage in ("frames", "fine", "evaluate") for path in (WORK / "store" / stage).rglob("*") if path.is_file()
    )
    places = [heard(str(age), 86400 * age) for age in (3, 1, 2)]
    result = cli("gc", "--keep-bytes", str(results + 1500))
    assert result.out.count("removed ") == 2 and [place.exists() for place in places] == [False, True, False], result.out
    assert "0 results" in result.out
    assert cli("gc", "--keep-bytes", str(results - 1)).out.count("removed ") >= 2 and not places[1].exists(), "then results go, too"
    assert "done in" not in cli("run", "all", capture, "--set", "fine.iterations=5").out


def test_gc_spares_what_another_process_reads_until_that_dies(cli, capture):
    file = archive(capture)
    words = [sys.executable, "-c", HOLDS, str(file), str(WORK)]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None and process.stdout.readline() == "open\n"
        (folder,) = (WORK / "unpacked").iterdir()
        used(folder, 40 * 86400)
        out = cli("gc", "--older-than", "30d").out
        assert f"left unpacked/{folder.name}: a process uses it" in out and (folder / "scene" / "000.png").is_file()
        process.kill()
        process.wait()
        assert f"removed unpacked/{folder.name}" in cli("gc", "--older-than", "30d").out and not folder.exists()


def test_a_session_holds_it_as_long_as_its_capture_lives(capture, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    session = open_session(Options(archive(capture), WORK, Choice(device="cpu")))
    (item,) = kept(WORK)
    assert not remove(item) and session.job.capture.root.is_dir()
    del session
    assert remove(item) and not item.path.exists()


def test_what_is_being_unpacked_stays_and_what_a_dead_run_left_goes(capture, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    file = archive(capture)
    import e4dgs.workflows.storage.archive as module

    original, seen = module._unpack, []

    def unpack(file: Path, folder: Path) -> None:
        original(file, folder)
        seen.extend(remove(item) for item in kept(WORK))
        assert folder.is_dir()

    monkeypatch.setattr(module, "_unpack", unpack)
    folder = unpacked(file, WORK, InUse()).parent
    assert seen == [False]
    dead = shutil.copytree(folder, WORK / "unpacked" / f".{folder.name}-abcd")  # as a kill leaves it
    (WORK / "unpacked" / ".just-begun").mkdir()
    assert {item.path.name for item in kept(WORK)} == {folder.name, dead.name}
    assert all(remove(item) for item in kept(WORK)) and [path.name for path in (WORK / "unpacked").iterdir()] == [".just-begun"]


@pytest.mark.parametrize("user", [True, False])
def test_what_is_taken_away_just_before_it_is_used_is_unpacked_again(capture, tmp_path, monkeypatch, user):
    monkeypatch.chdir(tmp_path)
    file = archive(capture)
    root = unpacked(file, WORK)
    import e4dgs.workflows.storage.archive as module

    original = module._held

    def held(folder: Path, user: object) -> bool:
        monkeypatch.setattr(module, "_held", original)
        assert all(remove(item) for item in kept(WORK))
        return original(folder, user)

    monkeypatch.setattr(module, "_held", held)
    assert unpacked(file, WORK, InUse() if user else None) == root and (root / "000.png").is_file()
