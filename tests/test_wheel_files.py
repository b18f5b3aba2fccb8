"""What a wheel would hold, by the rules of pyproject.toml: all that the program reads when it runs, and nothing else."""

import re
from pathlib import PurePosixPath

import pytest
from check_wheel import ROOT, expected
from script_module import load_script

FILES = sorted(map(PurePosixPath, expected()))
TEXT = {".cu", ".cuh", ".h", ".jinja", ".yaml", ".js", ".css", ".glsl"}  # read when it runs, beside Python: kernels, pages, clusters


def source(path: PurePosixPath) -> str:
    return ROOT.joinpath(*path.parts[1:]).read_text()


def test_only_the_package_is_in_it():
    dev = load_script(ROOT / "dev.py")
    assert {path.parts[:2] for path in FILES if len(path.parts) > 2} == {("e4dgs", folder) for folder in dev.FOLDERS}
    assert [path for path in FILES if len(path.parts) == 2] == [PurePosixPath("e4dgs/__init__.py")]
    strange = [str(path) for path in FILES if path.suffix not in {".py", *TEXT}]
    assert not strange, "neither Python nor read when it runs; leave it out in pyproject.toml, or name its kind here"
    assert not [str(path) for path in FILES if path.name.startswith(("test_", "conftest"))]


def test_it_has_every_file_beside_python_that_the_package_reads():
    """Kernels find what they include; every template is there."""
    present = {path.name for path in FILES}
    kernels = [path for path in FILES if path.suffix in {".cu", ".cuh", ".h"}]
    included = {name for path in kernels for name in re.findall(r'#include "(?:[\w./]*/)?(\w+\.\w+)"', source(path))}
    named = {name for path in FILES if path.suffix == ".py" for name in re.findall(r'"([\w./]+\.jinja)"', source(path))}
    assert len(included) > 10 and len(named) > 1
    assert included <= present and {PurePosixPath(name).name for name in named} <= present
    assert not [str(path) for path in kernels if path.suffix == ".h" and path.name not in included], "headers of the compiled part alone"


def test_it_is_small():
    assert sum(ROOT.joinpath(*path.parts[1:]).stat().st_size for path in FILES) < 3.05e6


@pytest.mark.parametrize("name", ["LICENSE", "README.md"])
def test_its_records_name_files_that_are_there(name):
    text = (ROOT / "pyproject.toml").read_text()
    assert (ROOT / name).is_file() and {"README.md": 'readme = "README.md"', "LICENSE": "Apache-2.0"}[name] in text
