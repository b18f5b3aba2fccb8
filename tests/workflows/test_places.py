"""Paths on the command line: none is empty, and no command writes over a capture."""

import os
from pathlib import Path

import pytest
from e4dgs.pipeline import SettingsError
from e4dgs.workflows.exports.render import _checked
from e4dgs.workflows.exports.trained import is_file
from e4dgs.workflows.machine.places import check_output, typed_output, typed_path

KINDS = ("flow", "ply", "spz", "sog", "gltf", "web", "4dgs", "usd", "mesh")
COMMANDS = [("render",), *(("export", kind) for kind in KINDS)]


def content(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
@pytest.mark.parametrize("out", ["000.png", "points3D.ply", "test", "."])
def test_no_command_writes_into_a_capture(cli, capture, command, out):
    before = content(capture)
    result = cli(*command, capture, "--out", capture / out)
    assert result.code == 2 and result.err.count("\n") == 1, result.err
    name = (capture / out).name
    assert f"--out {capture / out}: this would change the capture {capture}, which is never written to; --out {name} would do" in result.err
    assert content(capture) == before


def test_no_benchmark_writes_into_a_capture(cli, capture):
    for option in ("--out", "--plot"):
        result = cli("bench", "pipeline", capture, option, capture / "000.svg")
        assert result.code == 2 and f"{option} {capture}/000.svg: this would change the capture" in result.err
    assert cli("bench", "ablation", capture, "--out", capture).code == 2


def refused(out: Path, capture: Path, workspace: Path = Path("e4dgs-workspace")) -> bool:
    try:
        check_output("--out", out, capture, workspace)
    except SettingsError:
        return True
    return False


@pytest.fixture
def rig(tmp_path, monkeypatch):
    """A folder with a file, a link to a file elsewhere, and a link to a folder elsewhere; the current folder is beside it."""
    monkeypatch.chdir(tmp_path)
    for folder in ("rig", "disk/more"):
        Path(folder).mkdir(parents=True)
    for file in ("rig/cam00.mp4", "disk/cam01.mp4", "disk/more/cam02.mp4", "disk/other.mp4"):
        Path(file).touch()
    Path("rig/cam01.mp4").symlink_to("../disk/cam01.mp4")
    Path("rig/more").symlink_to("../disk/more")
    return Path("rig")


def test_links_are_followed_in_both_directions(rig):
    os.symlink("rig", "alias")
    os.symlink("rig/cam00.mp4", "mine.mp4")
    for out in ("rig/cam00.mp4", "rig/cam01.mp4", "alias/new", "mine.mp4", "disk/cam01.mp4", "disk/more/new.mp4", "disk/../rig/x", "disk"):
        assert refused(Path(out), rig) and refused(Path(out).absolute(), Path("alias")), out
    for out in ("rig.mp4", "rig2/cam00.mp4", "disk/other.mp4", "disk/new", "."):
        assert not refused(Path(out), rig), out


def test_a_capture_of_one_file_refuses_that_file_alone(rig):
    video = Path("rig/cam00.mp4")
    assert refused(video, video) and refused(Path("disk/cam01.mp4"), Path("rig/cam01.mp4")) and refused(video.absolute(), video)
    assert not refused(Path("rig/render.mp4"), video) and not refused(Path("rig"), video)


def test_a_workspace_in_the_capture_may_be_written_to(rig, monkeypatch):
    monkeypatch.chdir(rig)
    here = Path()
    assert not refused(Path("e4dgs-workspace/a.mp4"), here) and not refused(Path("e4dgs-workspace/scenes/rig/export"), here)
    assert refused(Path("a.mp4"), here) and refused(here, here)
    assert refused(Path("a.mp4"), here, workspace=here) and not refused(Path("scenes/rig/a.mp4"), here, workspace=here)
    with pytest.raises(SettingsError, match=r"--out e4dgs-workspace/a.mp4 would do"):
        check_output("--out", Path("a.mp4"), here, Path("e4dgs-workspace"))


@pytest.mark.parametrize(
    "words",
    [
        ("plan", ""),
        ("run", "all", ""),
        ("render", "", "--out", "a.mp4"),
        ("batch", ""),
        ("bench", "pipeline", ""),
        ("plan", "CAPTURE", "--workspace", ""),
        ("plan", "CAPTURE", "--store-also="),
        ("render", "CAPTURE", "--out", ""),
        ("export", "ply", "CAPTURE", "--out", ""),
        ("store", "gc", "--workspace", ""),
    ],
    ids=" ".join,
)
def test_an_empty_path_is_not_the_current_folder(cli, capture, words):
    result = cli(*(capture if word == "CAPTURE" else word for word in words))
    assert result.code == 2 and "is empty; give one" in result.err and not Path("e4dgs-workspace").exists(), result.err


def test_a_path_may_begin_with_the_home_folder(cli, capture, tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert typed_path("~/x") == tmp_path / "home" / "x" and typed_path("a/~/x") == Path("a/~/x")
    assert cli("run", "frames", capture, "--workspace=~/ws").code == 0
    assert (tmp_path / "home" / "ws" / "store").is_dir() and not Path("~").exists()
    result = cli("plan", capture, "--workspace=~no-such-user/ws")
    assert result.code == 2 and "~no-such-user/ws: there is no such user" in " ".join(result.err.split())
    for words in (("raster", "--garden=~/x"), ("step", "--rows", "split", "--capture=~/x")):
        assert f"{tmp_path}/home/x" in cli("bench", *words).err


@pytest.mark.parametrize("command", [("plan",), ("run", "all"), ("batch",), ("render", "--out", "a.mp4"), ("why", "frames")], ids=" ".join)
def test_a_workspace_at_or_below_a_file_is_refused(cli, capture, tmp_path, command):
    (tmp_path / "file").touch()
    for workspace in ("file", "file/ws"):
        result = cli(*command, capture, "--workspace", workspace)
        said = f"error: --workspace {workspace}: {tmp_path / 'file'} is a file, not a folder; give another --workspace\n"
        assert (result.code, result.err) == (2, said)


@pytest.mark.parametrize("name", ["new", "sh010_v1.2", "take.2026-11-30", "take.2026-11-30/", "a.ply/", "scene.mp4/", "there.ply"])
def test_what_means_a_folder(tmp_path, name):
    (tmp_path / "there.ply").mkdir()
    out = typed_output(f"{tmp_path}/{name}")
    assert not is_file(out, (".ply",)) and not _checked(out, alpha=True, depth=True)
    assert list(tmp_path.iterdir()) == [tmp_path / "there.ply"]


@pytest.mark.parametrize("name", ["a.splat", "a.4dgs", "a.7z"])
def test_an_unknown_ending_is_no_folder_and_the_ways_to_name_one_are_told(tmp_path, name):
    for refuse in (lambda out: is_file(out, (".ply",)), lambda out: _checked(out, alpha=False, depth=False)):
        with pytest.raises(SettingsError, match=r"must end in .*a folder exists, is typed with a / at its end, or has no ending"):
            refuse(typed_output(f"{tmp_path}/{name}"))
    (tmp_path / "file.1").touch()
    with pytest.raises(SettingsError, match="this is a file; name a folder"):
        is_file(typed_output(f"{tmp_path}/file.1"), (".ply",))
