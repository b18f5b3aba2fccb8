"""`e4dgs list`, `show`, `diff`: what is there, how it was made, and in what two results differ."""

import io
import json
import shutil
from pathlib import Path

STORE = Path("e4dgs-workspace/store")


def keys(stage: str) -> list[str]:
    return sorted(path.name for path in (STORE / stage).iterdir())


def test_list_has_every_result_with_its_scenes(cli, capture):
    cli("run", "all", capture)
    cli("run", "all", capture, "--set", "fine.iterations=5", "--name", "short")
    out = cli("list").out
    assert out.splitlines()[-1].startswith("5 results, ")
    (frames,) = [line for line in out.splitlines() if line.startswith("frames")]
    assert keys("frames")[0][:12] in frames and "my-scene, short" in frames
    rows = json.loads(cli("list", "fine", "--json").out)
    assert sorted(row["key"] for row in rows) == keys("fine") and sorted(row["scenes"][0] for row in rows) == ["my-scene", "short"]
    for row in rows:
        files = [path for path in (STORE / "fine" / row["key"]).rglob("*") if path.is_file()]
        assert row["bytes"] == sum(path.stat().st_size for path in files) and row["made"].startswith("20")
        provenance = json.loads((STORE / "fine" / row["key"] / "manifest.json").read_text())["provenance"]
        assert row["seconds"] == provenance["seconds"] > 0


def test_a_stage_that_the_last_run_skipped_is_no_longer_used_by_the_scene(cli, capture):
    cli("run", "all", capture)
    cli("run", "all", capture, "--set", "fine.iterations=0")
    assert "my-scene" in cli("list", "frames").out and "my-scene" not in cli("list", "fine").out
    assert cli("show", "my-scene", "fine").code == cli("diff", "my-scene/fine", "my-scene/frames").code == 2
    assert "fine would be skipped" in cli("why", "fine", capture, "--set", "fine.iterations=0").out
    assert "removed fine/" in cli("gc").out


def test_a_result_is_found_by_key_by_its_first_digits_and_by_scene_and_stage(cli, capture):
    cli("run", "all", capture)
    (key,) = keys("fine")
    for words in ((key,), (key[:6],), (f"fine/{key[:4]}",), ("my-scene", "fine"), ("my-scene/fine",)):
        assert cli("show", *words).out.startswith(f"fine/{key}\n")
    for words, said in (
        (("abc",), "names no result"),
        (("my-scene", "flow"), "it has evaluate, fine, frames"),
        (("nobody", "fine"), "names no result"),
    ):
        result = cli("show", *words)
        assert result.code == 2 and said in result.err


def test_several_results_that_begin_alike_are_named(cli, capture):
    cli("run", "all", capture)
    (key,) = keys("fine")
    shutil.copytree(STORE / "fine" / key, STORE / "fine" / (key[:8] + "0" * 24))
    result = cli("show", key[:8])
    assert result.code == 2 and "several results begin so" in result.err and key in result.err


def test_show_tells_how_a_result_was_made(cli, capture):
    cli("run", "all", capture, "--set", "fine.iterations=7")
    out = cli("show", "my-scene", "fine").out
    assert "fine.iterations: 7" in out and f"input frames: frames/{keys('frames')[0]}" in out
    assert "scenes: my-scene" in out and "said: all steps done" in out and "MB of memory, on cpu" in out and "numpy" in out
    assert json.loads(cli("show", "my-scene", "fine", "--json").out)["provenance"]["settings"]["iterations"] == 7
    shutil.rmtree(STORE / "frames")
    out = cli("show", "my-scene", "fine").out
    assert "no longer in the store" in out and "damaged" not in out
    (STORE / "fine" / keys("fine")[0] / "info.json").unlink()
    assert "damaged: " in cli("show", "my-scene", "fine").out


def test_show_lists_the_arrays(dnerf_capture, tmp_path, capsys):
    from e4dgs.workflows.cli import main

    words = ["--workspace", str(tmp_path)]
    assert main(["run", "frames", str(dnerf_capture.root), *words]) == 0
    capsys.readouterr()
    assert main(["show", dnerf_capture.root.name, "frames", *words]) == 0
    assert "array seconds: 18 float64 s\n" in capsys.readouterr().out


def test_diff_names_settings_inputs_and_whether_the_content_differs(cli, capture):
    cli("run", "all", capture)
    cli("run", "all", capture, "--set", "fine.iterations=5", "--name", "short")
    result = cli("diff", "my-scene/fine", "short/fine")
    assert result.code == 0 and "  settings.iterations: 10 -> 5\n" in result.out and result.out.endswith("the content differs\n")
    out = cli("diff", "my-scene/evaluate", "short/evaluate").out
    line = next(line for line in out.splitlines() if "input fine" in line)
    assert f"input fine changed: e4dgs store diff fine/{json.loads(record('my-scene'))['key']} fine/" in line
    assert cli(*line.split("e4dgs ")[1].split()).code == 0, "the command that it names works"
    assert cli("diff", "my-scene/frames", "short/frames").out.endswith("the content is the same\n")
    result = cli("diff", "my-scene/fine", "short/frames")
    assert result.code == 2 and "give two of one stage" in result.err


def record(scene: str) -> str:
    return (Path("e4dgs-workspace/scenes") / scene / "records" / "fine.json").read_text()


def test_a_narrow_list_leaves_columns_out_and_says_so_and_cuts_nothing():
    from e4dgs.workflows.storage.store import TITLES
    from e4dgs.workflows.storage.table import fitted
    from rich.console import Console

    row = {"stage": "evaluate", "key": "491820f85183", "size": "112.9 MB", "took": "2 min 50 s", "memory": "1526 MB", "pins": ""}
    row |= {"made": "2026-11-28T21:03:57Z", "age": "41 min", "scenes": "a-scene-with-a-long-name, another-one, the-third"}
    for width, names in (
        (180, [*TITLES]),
        (92, ["stage", "key", "size", "took", "memory", "made", "scenes"]),
        (60, ["stage", "key", "size", "age", "scenes"]),
        (45, ["stage", "key", "size", "age"]),
    ):
        table, missing = fitted([row, row | {"stage": "fine"}], TITLES, width)
        shown = io.StringIO()
        Console(width=width, file=shown).print(table)
        lines = shown.getvalue().splitlines()
        assert lines[0].split() == names and max(map(len, lines)) <= width
        begin = lines[0].index("scenes") if "scenes" in names else width
        scenes = "".join("".join(line[begin:] for line in lines[1:]).split())
        assert scenes == 2 * "".join(row["scenes"].split()) if "scenes" in names else not scenes, "folded, not cut"
        for name in {*names} - {"scenes", "stage"}:
            assert sum(row[name] in line for line in lines[1:]) == (0 if name == "pins" else 2) or not row[name]
        assert {*names, *missing} >= {"stage", "key", "size", "took", "memory", "scenes"} and "…" not in shown.getvalue()
    assert missing == ["memory", "took", "scenes"]


def test_ages_are_short():
    from datetime import UTC, datetime

    from e4dgs.workflows.storage.amounts import age

    now = datetime(2026, 11, 28, 12, 0, 0, tzinfo=UTC)
    made = ("2026-11-28T11:59:20Z", "2026-11-28T11:48:00Z", "2026-11-28T07:00:00Z", "2026-11-25T12:00:00Z", "2027-01-01T00:00:00Z", "")
    assert [age(one, now) for one in made] == ["40 s", "12 min", "5 h", "3 d", "0 s", ""]


def test_a_mistyped_workspace_or_stage_is_no_empty_store(cli, capture):
    Path("empty").mkdir()
    for command in (["list"], ["list", "--json"], ["verify"], ["gc"], ["gc", "--dry-run"]):
        for workspace in ("typo", "empty"):
            result = cli("store", *command, "--workspace", workspace)
            assert result.code == 2 and f"--workspace {workspace}: there is no workspace here" in result.err, command
    assert not Path("typo").exists() and not list(Path("empty").iterdir())
    cli("run", "frames", capture)
    result = cli("store", "list", "corse")
    assert result.code == 2 and "there is no stage 'corse'; give one of: frames, " in result.err
    assert "0 results" in cli("store", "list", "coarse").out, "a stage that has not run yet"
    assert cli("store", "verify").code == cli("store", "gc").code == 0
