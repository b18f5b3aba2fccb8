"""A folder of numbered files has the whole of a new export or the earlier one, whenever the export is interrupted."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from e4dgs.stages.exports.numbered import indexed, new_sequence, numbered, sequence_in, staged, strangers, write_index


def write(folder: Path, count: int, text: str) -> None:
    for k in range(count):
        numbered(folder, k, ".ply").write_text(text)


def contents(folder: Path) -> dict[str, str]:
    return {file.name: file.read_text() for file in folder.iterdir() if file.is_file()}


def test_a_new_sequence_replaces_the_earlier_one_and_nothing_else(tmp_path):
    others = dict.fromkeys(("frame0009.ply.bak", "frame9.ply", "frame00009.ply", "frame0009.PLY", "frame0001.spz"), "mine")
    for name, text in others.items():
        (tmp_path / name).write_text(text)
    for count in (5, 2, 3):
        with new_sequence(tmp_path, ".ply") as part:
            write(part, count, f"of {count}")
        assert contents(tmp_path) == others | {f"frame000{k + 1}.ply": f"of {count}" for k in range(count)}
        assert not [one for one in tmp_path.iterdir() if one.is_dir()]


@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError])
def test_an_interrupted_export_changes_nothing(tmp_path, error):
    write(tmp_path, 4, "earlier")
    with pytest.raises(error), new_sequence(tmp_path, ".ply") as part:
        write(part, 2, "new")
        raise error
    assert contents(tmp_path) == {f"frame000{k + 1}.ply": "earlier" for k in range(4)} and len(list(tmp_path.iterdir())) == 4
    with pytest.raises(error), new_sequence(tmp_path / "new" / "folder", ".ply") as part:
        write(part, 2, "new")
        raise error
    assert not (tmp_path / "new").exists(), "nor is an empty folder left"


@pytest.mark.parametrize("moved", [0, 1, 3])
def test_an_interrupted_move_leaves_no_sequence_that_looks_whole(tmp_path, monkeypatch, moved):
    write(tmp_path, 6, "earlier")
    real, done = os.replace, []

    def replace(source: Path, target: Path) -> None:
        if len(done) == moved:
            raise KeyboardInterrupt
        done.append(target)
        real(source, target)

    monkeypatch.setattr("e4dgs.stages.exports.numbered.os.replace", replace)
    with pytest.raises(KeyboardInterrupt), new_sequence(tmp_path, ".ply") as part:
        write(part, 4, "new")
    assert "frame0001.ply" not in contents(tmp_path) and "earlier" not in contents(tmp_path).values()


def test_a_killed_export_leaves_the_earlier_sequence(tmp_path):
    write(tmp_path, 3, "earlier")
    code = (
        "import os, pathlib, sys; from e4dgs.stages.exports.numbered import *\n"
        "with new_sequence(pathlib.Path(sys.argv[1]), '.ply') as part:\n"
        "    numbered(part, 0, '.ply').write_text('new'); os._exit(9)"
    )
    assert subprocess.run([sys.executable, "-c", code, str(tmp_path)]).returncode == 9
    assert contents(tmp_path) == {f"frame000{k + 1}.ply": "earlier" for k in range(3)}
    assert [file.name for file in sequence_in(tmp_path, ".ply")] == ["frame0001.ply", "frame0002.ply", "frame0003.ply"]
    with staged(tmp_path) as one, staged(tmp_path) as other:
        folders = {path for path in tmp_path.iterdir() if path.is_dir()}
        assert folders == {one, other}, "what it left goes with the next export, and what another export writes stays"


def test_a_folder_for_parts_goes(tmp_path):
    with staged(tmp_path / "a" / "b") as part:
        assert part.parent == tmp_path / "a" / "b" and part.name.startswith(".")
        (part.parent / "kept").write_text("")
    assert [one.name for one in (tmp_path / "a" / "b").iterdir()] == ["kept"]


def test_an_index_lists_the_files_of_each_kind(tmp_path):
    for ending, count in ((".ply", 5), (".spz", 2), (".ply", 3)):
        with new_sequence(tmp_path, ending) as part:
            for k in range(count):
                numbered(part, k, ending).write_text("data")
            write_index(part, ending, [k / (count - 1) for k in range(count)], 2.0, {"format": ending[1:], "antialiased": True})
    found = indexed(tmp_path)
    assert set(found) == {".ply", ".spz"} and found[".ply"]["antialiased"] and found[".ply"]["rate"] == 1.0
    assert [(row["file"], row["seconds"]) for row in found[".ply"]["files"]] == [(f"frame000{k + 1}.ply", 1.0 * k) for k in range(3)]
    assert strangers(tmp_path, ".ply") == strangers(tmp_path, ".spz") == []


@pytest.mark.parametrize("name", ["0001.ply", "frame_12.PLY", "frame0001.ply", "frame0007.compressed.ply"])
def test_numbered_files_of_others_are_strangers(tmp_path, name):
    assert strangers(tmp_path / "new", ".ply") == []
    for other in (name, "readme.txt", "point_cloud.ply", "frame0001.spz", "frame0001.ply.bak"):
        (tmp_path / other).write_text("mine")
    assert strangers(tmp_path, ".ply") == [name]
    for hostile in ("[]", '{".ply": 3}', '{".ply": {"files": 3}}', "[" * 10_000):
        (tmp_path / "sequence.json").write_text(hostile)
        assert strangers(tmp_path, ".ply") == [name]
