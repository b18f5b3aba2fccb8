"""After an edit of this package's source, what it reaches runs again and the reason names the file. Done to a copy."""

import ast
import json
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from e4dgs.pipeline import Stage
from e4dgs.pipeline.code.native_source import LIST, write_list
from e4dgs.pipeline.code.python_source import PLANNING
from e4dgs.pipeline.code.reach import reached, sources_of
from e4dgs.pipeline.code.sources import File
from e4dgs.workflows import cli
from e4dgs.workflows.reconstruction import reconstruction

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ("pipeline", "rasterizer", "scene", "stages", "vision", "workflows")
STAGES = {stage.name: stage for stage in reconstruction()}


class Copy:
    """Of the package, in a folder. ``code`` is what a stage reaches there, as it is now."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def code(self, stage: type[Stage], cuda: bool = False) -> dict[str, Any]:
        return reached(stage, sources_of({"e4dgs": [self.folder]}), cuda)

    def digests(self, cuda: bool = False) -> dict[str, str]:
        sources = sources_of({"e4dgs": [self.folder]})  # one for all stages, or each would read the same hundreds of files again
        return {name: reached(type(stage), sources, stage.device_class and cuda)["digest"] for name, stage in STAGES.items()}

    def add(self, name: str, line: str) -> None:
        (self.folder / name).write_text((self.folder / name).read_text() + line + "\n")


@pytest.fixture(scope="module")
def pristine(tmp_path_factory) -> Iterator[Copy]:
    folder = tmp_path_factory.mktemp("pristine") / "e4dgs"
    for name in FOLDERS:
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("*.so", "__pycache__"))
    shutil.copyfile(ROOT / "__init__.py", folder / "__init__.py")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("E4DGS_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield Copy(folder)


@pytest.fixture
def copy(pristine, tmp_path) -> Copy:
    shutil.copytree(pristine.folder, tmp_path / "e4dgs")
    return Copy(tmp_path / "e4dgs")


def rerun(copy: Copy, name: str, line: str, cuda: bool = False) -> set[str]:
    """Stages whose keys change when a line is added to a file."""
    before = copy.digests(cuda)
    copy.add(name, line)
    after = copy.digests(cuda)
    return {stage for stage in STAGES if before[stage] != after[stage]}


@pytest.mark.parametrize(
    ("name", "stages"),
    [
        ("stages/captures/checks.py", {"frames"}),
        ("vision/flow/two_way.py", {"poses", "flow", "seeds"}),
        ("vision/cpu/correlate.cpp", {"poses", "flow", "seeds"}),
        ("vision/sfm/worker/survey.py", {"poses", "depth", "seeds"}),
        ("scene/training/rates.py", {"coarse", "fine"}),
        ("rasterizer/math/hull.h", {"depth", "seeds", "coarse", "hulls", "fine", "evaluate"}),
        ("stages/evaluate/judge.py", {"evaluate"}),
        ("stages/estimates.py", set()),
        ("stages/report/page.py", set()),
        ("rasterizer/cuda/alpha.cuh", set()),
        ("pipeline/plan.py", set()),
        ("workflows/publish.py", set()),
    ],
)
def test_what_an_edit_reruns(copy, name, stages):
    python = name.endswith(".py")
    assert rerun(copy, name, "# a comment" if python else "// a comment") == set()
    assert rerun(copy, name, "MORE = 1" if python else "constexpr int kMore = 1;") == stages


def test_an_edit_of_a_kernel_of_the_gpu_reruns_what_was_computed_on_one(copy):
    line = "constexpr int kMore = 1;"
    assert rerun(copy, "rasterizer/cuda/alpha.cuh", line, cuda=True) == {"depth", "coarse", "hulls", "fine", "evaluate"}


def test_an_installed_package_has_the_same_keys(copy):
    """It has the list that the build writes, and no C++ sources."""
    before, on_gpu = copy.digests(), copy.digests(cuda=True)
    write_list(copy.folder, copy.folder / LIST)
    for path in [path for folder in copy.folder.glob("*/cpu") for path in folder.iterdir() if path.suffix != ".py"]:
        path.unlink()
    assert copy.digests() == before and copy.digests(cuda=True) == on_gpu


def test_commands_name_the_file(n3v_capture, copy, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("e4dgs.pipeline.keys.code_of", copy.code)
    monkeypatch.setattr("signal.signal", lambda *arguments: None)

    def command(*words: str) -> str:
        monkeypatch.setattr(cli, "console", cli.Console(width=400, force_terminal=False))
        assert cli.main([*words, "--workspace", str(tmp_path / "workspace")]) == 0
        return capsys.readouterr().out

    words = [str(n3v_capture.root), "--device", "cpu"]
    command("run", "flow", *words)
    copy.add("vision/flow/two_way.py", "# a comment")
    assert command("why", "flow", *words) == "flow would be reused: nothing changed\n"
    copy.add("vision/flow/two_way.py", "MORE = 1")
    copy.add("vision/cpu/correlate.cpp", "constexpr int kMore = 1;")
    said = "vision/cpu/correlate.cpp and vision/flow/two_way.py have changed"
    assert command("why", "flow", *words) == f"flow would run: {said}\n"
    rows = {row["stage"]: row for row in json.loads(command("plan", *words, "--json"))["stages"]}
    assert rows["frames"]["state"] == "cached" and (rows["flow"]["state"], rows["flow"]["reason"]) == ("run", said)
    assert f"flow: {said}\n" in command("run", "flow", *words)
    old, new = sorted((tmp_path / "workspace" / "store" / "flow").iterdir(), key=lambda path: path.stat().st_mtime)
    assert said in command("diff", old.name, new.name)
    assert re.search(r"made by: code [0-9a-f]{12} of \d\d files", command("show", new.name))


def test_nothing_that_is_imported_or_included_is_lost(pristine):
    """Of all files that stages reach: each relative import leads to a file, and nothing is imported under a name that is put together."""
    sources = sources_of({"e4dgs": [pristine.folder]})
    reached_by_any = {name for stage in STAGES.values() for name in reached(type(stage), sources, cuda=True)["files"]}
    assert len(reached_by_any) > 250
    for name in sorted(reached_by_any):
        text, leads = (pristine.folder / name).read_text(), {file.name for file in sources.leads(File("e4dgs", name))}
        if not name.endswith(".py"):
            included = [Path(header).name for header in re.findall(r'#include "([^"]+)"', text)]
            assert sorted(included) == sorted(Path(lead).name for lead in leads), name
            continue
        if not name.endswith("__init__.py"):
            assert not re.search(r"import_module|__import__|runpy", text), f"{name}: what it imports so does not count in keys"
        assert '"-m"' not in text or "worker.__name__" in text, f"{name}: import the module that it runs, so that it counts in keys"
        tree = ast.parse(text)
        passed_over = [node for node in ast.walk(tree) if getattr(getattr(node, "test", None), "id", "") == "TYPE_CHECKING"]
        passed_over += [node for node in ast.walk(tree) if getattr(node, "name", "") in PLANNING]
        ignored = {id(inner) for node in passed_over for inner in ast.walk(node)}
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and node.level and id(node) not in ignored:
                folder = Path(name).parents[node.level - 1] / (node.module or "").replace(".", "/")
                if folder.parts[:1] != ("pipeline",):
                    names = [folder / alias.name for alias in node.names]
                    wanted = {f"{path}.py" for path in (folder, *names)} | {f"{path}/__init__.py" for path in (folder, *names)}
                    native = any(alias.name.startswith("_") for alias in node.names) and any("/cpu/" in lead for lead in leads)
                    assert wanted & leads or native, f"{name}: {ast.unparse(node)}"
