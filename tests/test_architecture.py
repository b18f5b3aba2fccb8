"""The house rules that a machine can hold: imports point down, heavy libraries load late, every folder has a DESIGN.md."""

import ast
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
from e4dgs.workflows.reconstruction import reconstruction

ROOT = Path(__file__).resolve().parents[1]
BELOW = {
    "pipeline": set(),
    "rasterizer": set(),
    "scene": {"pipeline", "rasterizer"},
    "vision": {"pipeline"},
    "stages": {"scene", "vision", "pipeline", "rasterizer"},
    "workflows": {"stages", "scene", "vision", "pipeline", "rasterizer"},
}
ROOMS = ("rasterizer.cuda.runtime",)  # folders with a public face: others import what their __init__.py exports, and nothing behind it
STAGES = [stage.name for stage in reconstruction()]
LIGHT = ("__init__", "settings", "defaults", "stage", "artifact")
LATE = ("torch", "cv2", "scipy", "pycolmap", "open3d", "kornia")


def imported_folders(path: Path) -> set[str]:
    """Folders of the house that a file imports, relatively or as e4dgs.*, at any depth; its own folder included."""
    package = ("e4dgs", *path.relative_to(ROOT).parts[:-1])
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            targets = [tuple(alias.name.split(".")) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            module = (*base, *(node.module or "").split(".")) if node.module else base
            targets = [(*module, alias.name) for alias in node.names]
        else:
            continue
        found |= {target[1] for target in targets if len(target) > 1 and target[0] == "e4dgs"}
    return found


@pytest.mark.parametrize("folder", BELOW)
def test_imports_point_down(folder):
    for path in sorted((ROOT / folder).rglob("*.py")):
        above = imported_folders(path) & (BELOW.keys() - BELOW[folder] - {folder})
        assert not above, f"{path.relative_to(ROOT)} imports {above}; {folder} may import {BELOW[folder] or 'nothing of ours'}"


def test_the_rule_sees_every_form_of_import(tmp_path, monkeypatch):
    (tmp_path / "scene" / "sub").mkdir(parents=True)
    path = tmp_path / "scene" / "sub" / "x.py"
    path.write_text(
        "import e4dgs.workflows.cli\nfrom ...stages import frames\ndef f():\n    from ... import rasterizer\n"
        "from ..model import Model\nfrom e4dgs.pipeline import Stage\n"
    )
    monkeypatch.setitem(globals(), "ROOT", tmp_path)
    assert imported_folders(path) == {"workflows", "stages", "rasterizer", "scene", "pipeline"}


def helpers_imported(path: Path, root: Path) -> set[Path]:
    """Files of the tests that a test imports by their absolute name: from ``root``, or from its own folder."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    places = [folder / name.replace(".", "/") for name in names for folder in (root, path.parent)]
    return {file for place in places for file in (place.with_suffix(".py"), place / "__init__.py") if file.is_file()}


@pytest.mark.parametrize("folder", [folder for folder, below in BELOW.items() if not below])
def test_the_lowest_floor_is_tested_alone(folder):
    waiting, seen = set((ROOT / "tests" / folder).rglob("*.py")), set()
    while waiting:
        path = waiting.pop()
        seen.add(path)
        others = imported_folders(path) & (BELOW.keys() - {folder})
        assert not others, f"tests of {folder} reach {others} by {path.relative_to(ROOT)}"
        waiting |= helpers_imported(path, ROOT / "tests") - seen


def test_helpers_of_tests_are_followed(tmp_path):
    (tmp_path / "inner").mkdir()
    for name in ("far.py", "inner/near.py", "inner/__init__.py", "inner/test_x.py"):
        (tmp_path / name).touch()
    path = tmp_path / "inner" / "test_x.py"
    path.write_text("import far\nimport json\nfrom near import x\nfrom inner import near\n")
    assert {file.relative_to(tmp_path).as_posix() for file in helpers_imported(path, tmp_path)} == {
        "far.py", "inner/near.py", "inner/__init__.py",
    }  # fmt: skip


def imported_files(path: Path, known: dict[str, Path]) -> set[str]:
    """Files of the house that a file imports, as dotted names: inside functions and for type checkers alone, too."""
    package = path.relative_to(ROOT).parts[:-1]
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.level:
            base = ".".join([*package[: len(package) - node.level + 1], *(node.module or "").split(".")]).rstrip(".")
            for alias in node.names:
                name = f"{base}.{alias.name}"
                if name in known or alias.name not in ("_cpu", "_kernels"):  # native modules import nothing
                    found.add(name if name in known else base)
    return found & known.keys()


def circles(graph: dict[str, set[str]]) -> list[str]:
    """Names that can be reached from themselves."""
    left = dict(graph)
    while True:  # what imports nothing that is left, or is imported by nothing that is left, lies on no circle
        imported = set().union(*left.values()) if left else set()
        gone = [name for name, needs in left.items() if name not in imported or not needs & left.keys()]
        if not gone:
            return sorted(left)
        for name in gone:
            del left[name]


@pytest.fixture(scope="module")
def product() -> dict[str, Path]:
    """Every file of the product by its dotted name."""
    known = {}
    for path in sorted(path for folder in BELOW for path in (ROOT / folder).rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        known[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return known


def test_no_file_imports_itself_through_others(product):
    assert not circles({name: imported_files(path, product) for name, path in product.items()})


def test_of_another_stage_only_the_artifact_is_imported(product):
    """And only of one that runs before: so a stage's key holds no other stage's work, and each can be replaced alone."""
    for name, path in product.items():
        of = name.split(".")[1:2]
        if not name.startswith("stages.") or of[0] not in (*STAGES, "shared"):
            continue
        for other in imported_files(path, product):
            parts = other.split(".")
            if parts[0] == "stages" and len(parts) > 1 and parts[1] in STAGES and parts[1] != of[0]:
                assert parts[2:] and parts[2].startswith("artifact"), f"{path.relative_to(ROOT)} imports {other}"
                before = of[0] == "shared" or STAGES.index(parts[1]) < STAGES.index(of[0])
                assert before, f"{path.relative_to(ROOT)} imports {other}, of a stage that runs after {of[0]}"


@pytest.mark.parametrize("room", ROOMS)
def test_rooms_are_entered_by_their_face(product, room):
    assert product[room].name == "__init__.py"
    for name, path in product.items():
        if not f"{name}.".startswith(f"{room}."):
            behind = {other for other in imported_files(path, product) if other.startswith(f"{room}.")}
            assert not behind, f"{path.relative_to(ROOT)} imports {behind}, which {room} keeps to itself"


def test_circles_are_found():
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"b"}, "d": set()}) == ["b", "c"]
    assert circles({"a": {"b", "c"}, "b": {"c"}, "c": set()}) == []


def imports_inside(path: Path, but: tuple[str, ...] = ()) -> list[str]:
    """Functions of a file that import something, other than those named in ``but``."""
    functions = [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.FunctionDef) and node.name not in but]
    return [one.name for one in functions if any(isinstance(node, ast.Import | ast.ImportFrom) for node in ast.walk(one))]


@pytest.mark.parametrize("name", STAGES)
def test_a_stage_imports_its_work_in_run_alone(name):
    """What only a plan asks for is imported by the methods that a plan asks: so it is in no key."""
    path = ROOT / "stages" / name / "stage.py"
    inside = imports_inside(path)
    assert "run" in inside, "its work would load with the command line"
    assert set(inside) <= {"run", "estimate", "resources"}
    assert not re.search(r"^from \.\.estimates", path.read_text(), re.MULTILINE)


@pytest.mark.parametrize("room", [*STAGES, "shared"])
def test_rooms_import_at_the_top(room):
    files = [path for path in (ROOT / "stages" / room).glob("*.py") if path.name != "stage.py"]
    assert {path.name: found for path in files if (found := imports_inside(path))} == {}


@pytest.mark.parametrize("name", STAGES)
def test_the_package_of_a_stage_holds_a_docstring_alone(name):
    """Other stages read its artifact: what else the package imported would be in their keys, and would load with the command line."""
    body = ast.parse((ROOT / "stages" / name / "__init__.py").read_text()).body
    assert len(body) == 1 and isinstance(body[0], ast.Expr)


def named_by_hand(tree: ast.AST) -> list[int]:
    """Lines that reach into an artifact by a name that they spell themselves: `.attrs`, `.info[...]`, `.read("K")`, `.write("K", K)`,
    `"K" in frames`, ..."""
    lines = []
    for node in ast.walk(tree):
        match node:
            case ast.Attribute(attr="attrs"):
                found = True
            case ast.Subscript(value=ast.Attribute(attr="info")) | ast.Attribute(value=ast.Attribute(attr="info")):
                found = True
            case ast.Call(func=ast.Attribute(attr="read" | "array"), args=[name, *_]):
                found = is_text(name)
            case ast.Call(func=ast.Attribute(attr="write" | "create"), args=[name, _, *_]):  # text that goes to a file stands alone
                found = is_text(name)
            case ast.Compare(left=name, ops=[ast.In() | ast.NotIn()], comparators=[ast.Name(id=of)]):
                found = is_text(name) and of in (
                    "artifact",
                    "frames",
                    "poses",
                    "depth",
                    "flow",
                    "seeds",
                    "coarse",
                    "hulls",
                    "fine",
                    "evaluate",
                )
            case _:
                found = False
        if found:
            lines.append(node.lineno)
    return sorted(set(lines))


def is_text(node: ast.AST) -> bool:
    return isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Constant) and isinstance(node.value, str))


def test_one_room_spells_the_names_in_artifacts():
    """docs/artifacts.md is the contract; the `artifact.py` of a stage is the one place that holds it to that."""
    rooms = [path for folder in ("stages", "workflows") for path in (ROOT / folder).rglob("*.py")]
    own = [ROOT / "workflows" / "machine" / "doctor.py"]  # tries the store out, with an array of its own
    own += [path for name in STAGES for path in (ROOT / "stages" / name).glob("artifact*.py")]
    own += [ROOT / "stages" / "shared" / f"{name}.py" for name in ("model", "training_log", "report_attributes")]
    for path in sorted(path for path in rooms if path not in own):
        lines = named_by_hand(ast.parse(path.read_text()))
        assert not lines, (
            f"{path.relative_to(ROOT)}:{lines[0]} spells what an artifact holds; the artifact.py of its stage has typed readers and writers"
        )


def test_names_that_are_spelled_are_found():
    by_hand = ['a.attrs["x"]', 'b.info["x"]', 'b.info.get("x")', 'f.read("K", 3)', 'f.array(f"movie_{k}")', 'out.write("K", K)']
    by_hand += ['out.create("K", shape)', '"K" in frames']
    others = ['file.write("text")', "file.read(4)", "np.array([0])", '"x" in image.info', '"x" in words']
    assert named_by_hand(ast.parse("\n".join([*by_hand, *others]))) == [k + 1 for k in range(len(by_hand))]


@pytest.mark.parametrize("folder", BELOW)
def test_python_folders_are_small(folder):
    for inner in [ROOT / folder, *(path for path in (ROOT / folder).rglob("*") if path.is_dir())]:
        files = [path for path in inner.iterdir() if path.is_file() and path.suffix not in (".so", ".pyc")]
        if inner.name in ("cpu", "cuda"):  # kernels and their headers
            continue
        assert len(files) <= 15, f"{inner.relative_to(ROOT)} has {len(files)} files: give some of them a folder"


@pytest.mark.parametrize("folder", BELOW)
def test_files_are_short(folder):
    texts = (".py", ".cpp", ".h", ".inl", ".cu", ".cuh", ".jinja", ".yaml")
    for path in (path for path in (ROOT / folder).rglob("*") if path.suffix in texts):
        lines = len(path.read_text().splitlines())
        assert lines <= 300, f"{path.relative_to(ROOT)} has {lines} lines: give some of its ideas a file of their own"


@pytest.mark.parametrize("folder", BELOW)
def test_every_folder_has_a_design(folder):
    assert (ROOT / folder / "DESIGN.md").is_file(), f"{folder} has no DESIGN.md"


def test_heavy_libraries_load_late():
    """`import e4dgs`, the pipeline, the command line and every stage can be imported without them."""
    light = [*(ROOT / "stages").glob("*.py"), *(ROOT / "stages" / name / f"{part}.py" for name in STAGES for part in LIGHT)]
    stages = sorted("e4dgs." + ".".join(path.relative_to(ROOT).with_suffix("").parts) for path in light if path.is_file())
    names = ["e4dgs", "e4dgs.pipeline", "e4dgs.workflows.cli", "e4dgs.workflows.reconstruction", "e4dgs.stages", *stages]
    code = (
        "import importlib, json, sys\nfound = {}\n"
        f"for name in {names!r}:\n"
        "    importlib.import_module(name)\n"
        f"    found[name] = [heavy for heavy in {LATE!r} if heavy in sys.modules]\n"
        "print(json.dumps(found))"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    for name, heavy in json.loads(result.stdout).items():
        assert not heavy, f"importing {name} (or a module before it) imports {heavy}"
