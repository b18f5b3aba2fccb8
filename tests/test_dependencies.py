"""What is installed with e4dgs works for its keep: the product imports all of it, and nothing that is not asked for."""

import ast
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

ROOT = Path(__file__).resolve().parents[1]
PRODUCT = ("pipeline", "rasterizer", "scene", "stages", "vision", "workflows")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
NEEDED = [Requirement(line) for line in PROJECT["dependencies"]]
EXTRAS = {extra: [Requirement(line) for line in lines] for extra, lines in PROJECT["optional-dependencies"].items()}
DEV = EXTRAS.pop("dev")
MODULES = {  # what a distribution is imported as, where that is not its own name
    "cuda-bindings": "cuda.bindings",
    "cuda-pathfinder": "cuda.pathfinder",
    "open3d-cpu": "open3d",
    "opencv-contrib-python-headless": "cv2",
    "pillow": "PIL",
    "pyyaml": "yaml",
    "usd-core": "pxr",
}
LIBRARIES = {"nvidia-cuda-nvrtc", "nvidia-cuda-nvrtc-cu12", "lpips"}  # not imported: cuda-bindings loads them; files are read


def module_of(requirement: Requirement) -> str:
    name = canonicalize_name(requirement.name)
    return MODULES.get(name, "OpenEXR" if name == "openexr" else name.replace("-", "_"))


def imports(tree: ast.AST) -> Iterator[str]:
    """Dotted names of modules that run-time code imports absolutely; imports for type checkers alone do not count."""
    typing = [node for node in ast.walk(tree) if isinstance(node, ast.If) and getattr(node.test, "id", "") == "TYPE_CHECKING"]
    skipped = {id(inner) for node in typing for inner in ast.walk(node)}
    for node in ast.walk(tree):
        if id(node) in skipped:
            continue
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and not node.level and node.module:
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


@pytest.fixture(scope="module")
def imported() -> dict[str, Path]:
    """What the product imports of others, with a file that does."""
    found = {}
    for path in sorted(path for folder in PRODUCT for path in (ROOT / folder).rglob("*.py")):
        for name in imports(ast.parse(path.read_text())):
            if name.split(".")[0] not in {*sys.stdlib_module_names, "e4dgs"}:
                found[name] = path.relative_to(ROOT)
    return found


def within(name: str, module: str) -> bool:
    return f"{name}.".startswith(f"{module}.")


@pytest.mark.parametrize("requirement", [*NEEDED, *(one for extra in EXTRAS.values() for one in extra)], ids=lambda one: one.name)
def test_what_is_asked_for_is_imported(imported, requirement):
    if requirement.name not in LIBRARIES:
        module = module_of(requirement)
        assert any(within(name, module) for name in imported), f"{requirement.name} is in pyproject.toml, and nothing imports {module}"


def test_what_is_imported_is_asked_for(imported):
    asked = {module_of(one) for one in (*NEEDED, *(one for extra in EXTRAS.values() for one in extra))}
    for name, path in imported.items():
        assert any(within(name, module) for module in asked), f"{path} imports {name}, which pyproject.toml does not ask for"


def test_what_an_extra_brings_is_not_asked_for_by_all():
    needed = {canonicalize_name(one.name) for one in NEEDED}
    for extra, asked in EXTRAS.items():
        twice = needed & {canonicalize_name(one.name) for one in asked}
        assert not twice, f"{twice}: in dependencies, and in the extra {extra}"


def test_the_pins_are_within_the_ranges():
    lines = (line.split("#")[0].strip() for line in (ROOT / "constraints.txt").read_text().splitlines())
    pins = {canonicalize_name(name): Version(version) for name, _, version in (line.partition("==") for line in lines if line)}
    for one in (one for one in (*NEEDED, *DEV) if one.marker is None or one.marker.evaluate()):
        assert pins[canonicalize_name(one.name)] in one.specifier, f"constraints.txt and pyproject.toml disagree about {one.name}"


def test_imports_of_every_form_are_seen():
    code = (
        "import a.b, sys\nfrom c.d import e\nfrom . import f\nif TYPE_CHECKING:\n    import g\n"
        "def h():\n    try:\n        import i\n    except ImportError:\n        pass\n"
    )
    assert set(imports(ast.parse(code))) == {"a.b", "sys", "c.d.e", "i"}
