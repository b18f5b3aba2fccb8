"""Which folder of a workspace belongs to which capture, also if several runs start at the same time."""

import json
import subprocess
import sys
import unicodedata
from pathlib import Path

import pytest
from e4dgs.pipeline import SettingsError
from e4dgs.pipeline.files import read_json, write_json
from e4dgs.pipeline.names import is_safe, safe_name
from e4dgs.workflows.scenes import NameTakenError, Scene, find_scene
from e4dgs.workflows.session import Options, open_session

CLAIM = (
    "import sys; from pathlib import Path; from e4dgs.workflows.scenes import find_scene\n"
    "scenes = [find_scene(Path(sys.argv[1]), Path(sys.argv[2]), f'clip{k}', None) for k in range(int(sys.argv[3]))]\n"
    "print('ready', flush=True); sys.stdin.readline()\n"
    "print(' '.join(scene.claim().name for scene in scenes))"
)


def owner(scene: Scene) -> str:
    return read_json(scene.folder / "capture.json")["path"]


def both(workspace: Path, chosen: str | None = None) -> list[Scene]:
    """The scenes of two captures of one name, found before either has taken its folder."""
    return [find_scene(workspace, Path(path), "clip", chosen) for path in ("/one/clip", "/two/clip")]


def test_two_captures_that_start_at_the_same_time_share_no_folder(tmp_path):
    first, second = both(tmp_path)
    assert first.folder == second.folder
    first, second = first.claim(), second.claim()
    assert (first.name, owner(first), owner(second)) == ("clip", "/one/clip", "/two/clip")
    assert second.renamed and second.folder == find_scene(tmp_path, second.capture, "clip", None).folder != first.folder
    assert (first.claim().name, owner(first)) == ("clip", "/one/clip"), "again, it stays as it is"


def test_a_chosen_name_that_was_just_taken_is_refused(tmp_path):
    there = tmp_path / "one" / "clip"
    there.mkdir(parents=True)
    first, second = (find_scene(tmp_path, path, "clip", "mine") for path in (there, Path("/two/clip")))
    first.claim()
    for refused in (second.claim, lambda: find_scene(tmp_path, second.capture, "clip", "mine")):
        with pytest.raises(NameTakenError, match=rf"--name mine: this scene belongs to {there}; choose another --name"):
            refused()
    assert owner(first) == str(there)


def test_a_capture_that_was_moved_takes_its_scene_over_by_name_only(cli, capture):
    """Without --name the disk of the first capture may only be unmounted."""
    workspace = Path("e4dgs-workspace")
    assert cli("run", "all", capture, "--set", "frames.max_size=16").code == 0
    moved = capture.rename(capture.parent.parent / capture.name)
    said = cli("plan", moved).out
    assert f"a capture that is not there any more, {capture}, has this name" in said and "--name my-scene takes it over" in said
    assert "another capture" not in said
    missing = cli("report", moved)
    assert missing.code == 2 and f"The scene my-scene was made from {capture}, which is not there any more" in missing.err
    assert "moved, add --name my-scene" in missing.err
    assert "name the place that it was moved to, with --name my-scene" in cli("report", "my-scene").err
    result = cli("report", moved, "--name", "my-scene")  # as would a run
    assert result.code == 0 and f"the capture of scene my-scene was {capture}, which is gone; it is now {moved}" in result.out
    assert read_json(workspace / "scenes" / "my-scene" / "capture.json") == {"path": str(moved)}
    again = cli("run", "all", moved)
    assert "which is gone" not in again.out and [path.name for path in (workspace / "scenes").iterdir()] == ["my-scene"]


def test_a_capture_whose_place_cannot_be_looked_at_is_not_gone(tmp_path):
    find_scene(tmp_path, Path("/" + "x" * 300), "clip", "mine").claim()  # no file system has such a name: it is an error of another kind
    with pytest.raises(NameTakenError):
        find_scene(tmp_path, Path("/two/clip"), "clip", "mine")


def test_processes_that_race_for_a_hundred_names_share_none(tmp_path):
    paths = [f"/{k}/clip" for k in range(3)]
    command = [sys.executable, "-c", CLAIM, str(tmp_path)]
    racing = [subprocess.Popen([*command, path, "100"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) for path in paths]
    for process in racing:
        assert process.stdout.readline() == "ready\n"
    for process in racing:
        process.stdin.write("\n")
        process.stdin.flush()
    names = [process.communicate(timeout=120)[0].split() for process in racing]
    assert [len(set(own)) for own in names] == [100] * 3 and len({name for own in names for name in own}) == 300
    for path, own in zip(paths, names):
        assert {read_json(tmp_path / "scenes" / name / "capture.json")["path"] for name in own} == {path}


def test_a_claim_without_results_is_given_up_unless_another_process_shares_it(tmp_path):
    scene = find_scene(tmp_path, Path("/one/clip"), "clip", None)
    scene.claim().release()
    assert not (tmp_path / "scenes").exists()
    first = scene.claim()
    second = find_scene(tmp_path, scene.capture, "clip", None).claim()
    first.release()
    second.release()
    assert owner(scene) == "/one/clip", "the second process may still run"
    (other := find_scene(tmp_path, Path("/two/clip"), "other", None).claim()).folder.joinpath("plan.json").write_text("{}")
    other.release()
    assert owner(other) == "/two/clip", "there are results"


def test_a_run_writes_into_the_folder_that_it_got(cli, capture, tmp_path, monkeypatch):
    """Another capture takes the name after this one was recognised."""
    workspace = tmp_path / "e4dgs-workspace"
    taken = find_scene(workspace, Path("/other/my scene"), "my scene", None)
    found = open_session(Options(capture, workspace))

    def late(options: Options):
        taken.claim()
        return found

    monkeypatch.setattr("e4dgs.workflows.timing.begin.open_session", late)
    result = cli("run", "all", capture)
    assert result.code == 0 and "another capture has just taken the name my-scene" in result.out
    (own,) = (folder for folder in taken.folder.parent.iterdir() if folder != taken.folder)
    assert json.loads((own / "capture.json").read_text()) == {"path": str(capture)}
    assert json.loads((own / "plan.json").read_text())["scene"] == own.name and (own / "records" / "fine.json").is_file()
    assert [file.name for file in taken.folder.iterdir()] == ["capture.json"]


@pytest.mark.parametrize(
    ("name", "kept"),
    [
        ("日本", "日本"),
        ("jpg exif ümlaut", "jpg-exif-ümlaut"),
        (unicodedata.normalize("NFD", "Łódź é"), "Łódź-é"),
        ("हिन्दी ไทย١٢", "हिन्दी-ไทย١٢"),  # vowel signs and digits
        ("a - b__c", "a---b__c"),
        ("../..\u2215etc", "etc"),
        (".hidden\u202egp4\0\n\x1b[2J", "hiddengp4-2J"),
        ("clip \u2764\ufe0f 2", "clip-2"),
        ("\u0301\u200b\ufeff☃", ""),
        ("\udcff raw", "raw"),
        ("語" * 200, "語" * 53),
        ("x" * 200, "x" * 80),
    ],
)
def test_letters_and_digits_of_all_scripts_are_kept(tmp_path, name, kept):
    assert safe_name(name) == kept and is_safe(kept) == bool(kept)
    scenes = [find_scene(tmp_path, Path(path), name, None).claim() for path in ("/one", "/two")]
    assert scenes[0].name == (kept or "capture") and scenes[1].name.startswith(f"{scenes[0].name}-")
    for scene in scenes:
        assert find_scene(tmp_path, scene.capture, name, scene.name).folder == scene.folder, "as --name, too"
        write_json(tmp_path / "states" / f"{scene.name}.json", {})


@pytest.mark.parametrize(
    "name",
    [
        "",
        ".",
        "..",
        ".a",
        "-a",
        "_a",
        "a/b",
        "a\\b",
        "a b",
        "a\0",
        "a\n",
        "a\u202e",
        "a\u200d",
        "a\ufe0f",
        "\u0301a",
        "☃",
        "\udcff",
        "日" * 67,
        "x" * 101,
    ],
)
def test_what_is_no_name_is_refused(tmp_path, name):
    with pytest.raises(SettingsError, match="letters, digits"):
        find_scene(tmp_path, Path("/one"), "clip", name)


def test_a_name_is_found_however_its_accents_were_typed(cli, capture):
    typed = unicodedata.normalize("NFD", "Früh")
    assert len(typed) == 5
    assert cli("run", "all", capture, "--name", typed).code == 0
    assert [path.name for path in Path("e4dgs-workspace/scenes").iterdir()] == [unicodedata.normalize("NFC", "Früh")]
    for command in (["why", "fine", typed], ["store", "show", f"{typed}/fine"], ["store", "pin", typed], ["store", "unpin", typed]):
        assert (result := cli(*command)).code == 0, result.err


def test_a_folder_that_is_removed_during_a_run_is_claimed_again(tmp_path):
    scene = find_scene(tmp_path, Path("/one/clip"), "clip", None).claim()
    (scene.folder / "capture.json").unlink()
    scene.restore()
    assert owner(scene) == "/one/clip"
