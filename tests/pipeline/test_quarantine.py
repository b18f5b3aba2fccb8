"""Whatever happens to a file of a result: it is named, set aside and made again, and the run ends well."""

import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
import toy_stages
from e4dgs.pipeline import Artifact, ArtifactError, DamagedError, Runner
from e4dgs.pipeline.files import sizes
from hypothesis import given, settings
from hypothesis import strategies as st

FILES = ("zarr.json", "info.json", "manifest.json", "values/zarr.json", "values/c/0")


def damage(path: Path, how: str, position: float, bit: int) -> None:
    """position: in [0, 1), where in the file."""
    data = bytearray(path.read_bytes())
    place = int(position * len(data))
    if how == "delete":
        path.unlink()
    elif how == "truncate":
        path.write_bytes(data[:place])
    else:
        data[place] ^= 1 << bit
        path.write_bytes(data)


def flip(path: Path) -> None:
    damage(path, "flip", 0.5, 6)


def quarantined(bench) -> list[Path]:
    return sorted((bench.store.root / "quarantine").glob("*"))


@pytest.fixture(scope="module")
def template(tmp_path_factory):
    """A bench on which everything has been run, to copy, and the key of `numbers`."""
    bench = toy_stages.Bench.create(tmp_path_factory.mktemp("template"))
    outcomes = Runner(bench.job()).run()
    assert {str(file.relative_to(outcomes[0].artifact.path)) for file in outcomes[0].artifact.path.rglob("*") if file.is_file()} == {*FILES}
    return bench.root, outcomes[0].artifact.path.name


@settings(max_examples=30, deadline=None, derandomize=True, database=None)
@given(
    file=st.sampled_from(FILES),
    how=st.sampled_from(["flip", "truncate", "delete"]),
    position=st.floats(0, 1, exclude_max=True),
    bit=st.integers(0, 7),
)
def test_whatever_is_damaged_before_a_stage_reads_it_is_made_again(template, file, how, position, bit):
    source, key = template
    with tempfile.TemporaryDirectory() as folder:
        shutil.copytree(source, folder, dirs_exist_ok=True)
        bench = toy_stages.Bench(Path(folder))
        bench.runs()
        whole = Artifact(bench.store.path("numbers", key))
        good = whole.manifest
        damage(whole.path / file, how, position, bit)
        if file == "manifest.json" and how != "delete":
            try:
                if json.loads((whole.path / file).read_bytes()) == good:
                    return  # a space became another space: nothing is lost
            except ValueError:
                pass
        said: list[str] = []
        outcomes = Runner(bench.job(clipped__limit=1), said.append).run()
        assert bench.runs() == ["numbers", "clipped", "total"], "and nothing else, since the numbers are the same again"
        assert outcomes[0].state == "ran" and outcomes[1].state == "cached"
        assert outcomes[3].artifact.attrs["total"] == 3
        lines = [line for line in said if "damaged: " in line]
        (place,) = quarantined(bench)
        assert len(lines) == 1 and str(whole.path / file) in lines[0] and str(place) in lines[0]
        assert place.name.startswith(f"numbers-{key}-20")
        assert not any(problem for _, _, problem in bench.store.verify())


@pytest.mark.parametrize("file", FILES)
@pytest.mark.parametrize("how", ["flip", "truncate", "delete"])
def test_a_cached_run_makes_again_what_it_can_tell_without_reading_arrays(bench, file, how):
    path = Runner(bench.job()).run()[2].artifact.path / file
    bench.runs()
    damage(path, how, 0.5, 6)
    outcomes = Runner(bench.job()).run()
    unread = file == "values/c/0" and how == "flip"
    assert bench.runs() == ([] if unread else ["clipped"]), "what is the same again reruns nothing behind it"
    assert (len(quarantined(bench)), outcomes[3].state) == (0 if unread else 1, "cached")
    assert [problem != "" for _, _, problem in bench.store.verify()].count(True) == unread


def test_what_nobody_has_read_is_found_by_verify_and_set_aside(bench):
    path = Runner(bench.job()).run()[2].artifact.path
    flip(path / "values/c/0")
    assert bench.store.problem("clipped", path.name).startswith(f"{path / 'values/c/0'}: its content is not what was written")
    with bench.store.lock("clipped", path.name):
        assert bench.store.quarantine_damaged("clipped", path.name) is None, "a process builds it"
    place = bench.store.quarantine_damaged("clipped", path.name)
    assert (place / "values/c/0").is_file() and not path.exists()
    assert bench.store.quarantine_damaged("clipped", path.name) is None
    assert all(bench.store.quarantine_damaged(*entry) is None for entry in bench.store.entries()), "what is well stays"
    bench.runs()
    bench.run()
    assert bench.runs() == ["clipped"]


def test_runs_beside_one_another_make_a_damaged_result_once(bench):
    flip(Runner(bench.slow()).run(["numbers"])[0].artifact.path / "values/c/0")
    bench.runs()
    script = [sys.executable, str(Path(toy_stages.__file__)), str(bench.root), "3", "0.05"]
    processes = [subprocess.Popen(script, stdout=subprocess.DEVNULL) for _ in range(3)]
    assert [process.wait(timeout=60) for process in processes] == [0, 0, 0]
    assert sorted(bench.runs()) == ["numbers", "slow"] and len(quarantined(bench)) == 1


def test_a_disk_that_spoils_everything_ends_the_run(bench):
    path = Runner(bench.job()).run()[0].artifact.path
    flip(path / "values/c/0")

    def spoil(outcome) -> None:
        if outcome.state == "ran":
            flip(path / "values/c/0")

    with pytest.raises(ArtifactError, match="array 'values' is damaged"):
        Runner(bench.job(clipped__limit=1)).run(finished=spoil)


def test_attrs_info_and_descriptions_that_were_changed_are_not_believed(bench):
    path = Runner(bench.job()).run()[3].artifact.path
    for file in ("zarr.json", "info.json"):
        flip(path / file)
    with pytest.raises(ArtifactError, match=r"zarr\.json: its content is not what was written"):
        Artifact(path).attrs  # noqa: B018
    with pytest.raises(ArtifactError, match=r"info\.json: its content is not what was written"):
        Artifact(path).info  # noqa: B018
    values = Runner(bench.job()).run()[2].artifact.path
    description = values / "values/zarr.json"
    description.write_bytes(description.read_bytes().replace(b"int64", b"int32"))
    with pytest.raises(ArtifactError, match=r"values/zarr\.json: its content"):
        Artifact(values).read("values")


def test_what_cannot_be_opened_now_is_no_damage(bench):
    """Too many open files, or no permission: the result stays where it is, and the run says so."""
    bench.run()
    bench.runs()
    code = (
        "import os, resource, sys\nfrom pathlib import Path\nsys.path.insert(0, sys.argv[1])\n"
        "import toy_stages\nfrom e4dgs.pipeline import ArtifactError, make_plan\n"
        "job = toy_stages.Bench(Path(sys.argv[2])).job()\n"
        "assert [row.state for row in make_plan(job)] == ['cached'] * 4\n"
        "free = os.open('.', os.O_RDONLY)\nos.close(free)\n"
        "resource.setrlimit(resource.RLIMIT_NOFILE, (free + 2, free + 2))\n"  # enough for one artifact that is held, not for four
        "try:\n    make_plan(job)\nexcept ArtifactError as error:\n    print(error)\n"
    )
    words = [sys.executable, "-c", code, str(Path(toy_stages.__file__).parent), str(bench.root)]
    done = subprocess.run(words, capture_output=True, text=True)
    assert "(Too many open files)" in done.stdout, done.stderr
    assert set(bench.run().values()) == {"cached"} and not quarantined(bench)


def test_a_result_that_another_run_moves_away_while_it_is_opened_counts_as_damaged(bench, monkeypatch):
    bench.run()
    (key,) = [key for stage, key in bench.store.entries() if stage == "clipped"]
    path = bench.store.path("clipped", key)

    def moved_away(root: Path) -> dict[str, int]:
        os.rename(root, root.with_name("moved"))
        return sizes(root)

    monkeypatch.setattr("e4dgs.pipeline.storage.artifact.sizes", moved_away)
    with pytest.raises(DamagedError, match="cannot be read"):
        Artifact(path)
