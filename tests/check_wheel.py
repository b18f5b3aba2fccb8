"""`python tests/check_wheel.py FILE.whl`: the wheel has the files that it should have, and runs the sample where there is no compiler.

It is installed into a fresh environment, with the pinned versions, on a PATH without any other program. `python3 dev.py wheel --check`
builds one and calls this.
"""

import os
import shutil
import subprocess
import sys
import tempfile
import tomllib
import venv
import zipfile
from pathlib import Path, PurePosixPath

from printed_commands import ROOT, SAMPLE

COMPILERS = ("cc", "c++", "gcc", "g++", "clang", "clang++", "cmake", "ninja", "make")
NATIVE = ("e4dgs/rasterizer/_cpu.", "e4dgs/scene/_kernels.", "e4dgs/vision/_kernels.")
LIST = "e4dgs/native_sources.json"  # written by the build
RECORDS = {"METADATA", "WHEEL", "RECORD", "entry_points.txt", "licenses/LICENSE"}  # of *.dist-info
WANTED = ("frames", "seeds", "coarse", "hulls", "fine", "evaluate")  # stages that the sample has in the store


def expected() -> set[str]:
    """The paths in a wheel by the rules of pyproject.toml, native modules and records aside."""
    rules = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["scikit-build"]["wheel"]
    left_out = [pattern.removeprefix("**/") for pattern in rules["exclude"]] + ["*.so", "__pycache__/*"]
    found = {"e4dgs/__init__.py"}
    for place, folder in rules["packages"].items():
        files = (PurePosixPath(place, path.relative_to(ROOT / folder)) for path in (ROOT / folder).rglob("*") if path.is_file())
        found.update(str(path) for path in files if not any(path.match(pattern) for pattern in left_out))
    return found


def check_contents(wheel: Path) -> None:
    """The tag is one that auditwheel gives, and nothing is in it that should not be, or the other way round."""
    abi = "cp311-cp311" if sys.version_info < (3, 12) else "cp312-abi3"
    assert f"-{abi}-manylinux_" in wheel.name, f"{wheel.name}: expected the tags {abi}-manylinux_..."
    with zipfile.ZipFile(wheel) as archive:
        names = {name for name in archive.namelist() if not name.endswith("/")}
    native = {name for name in names if name.startswith(NATIVE) and name.endswith(".so")}
    records = {name for name in names if ".dist-info/" in name}
    assert len(native) == len(NATIVE), f"{wheel.name}: expected two native modules, found {sorted(native)}"
    assert {name.split(".dist-info/")[1] for name in records} == RECORDS, f"{wheel.name}: found {sorted(records)}"
    rest, wanted = names - native - records, expected() | {LIST}
    assert rest == wanted, f"{wheel.name}: lacks {sorted(wanted - rest)}, has besides {sorted(rest - wanted)}"


def check_use(wheel: Path, folder: Path) -> None:
    """In a fresh environment within ``folder`` it installs and runs the sample, without a compiler."""
    programs = folder / "environment" / "bin"
    venv.create(programs.parent, with_pip=True)
    kept = {key: value for key, value in os.environ.items() if key.startswith("PIP_") or key in ("HOME", "LANG", "OMP_NUM_THREADS")}
    variables = {**kept, "PATH": str(programs), "CXX": "", "CC": ""}

    def run(*words: str) -> str:
        done = subprocess.run(words, cwd=folder, env=variables, stdout=subprocess.PIPE, text=True)
        assert done.returncode == 0, f"{' '.join(words)} ended with {done.returncode}: {done.stdout[-2000:]}"
        return done.stdout

    pip = (str(programs / "python"), "-m", "pip")
    run(*pip, "install", "--quiet", "--only-binary", ":all:", "--constraint", str(ROOT / "constraints.txt"), str(wheel))
    found = [name for name in COMPILERS if shutil.which(name, path=str(programs))]
    assert not found, f"the environment has {found}, so this shows nothing"
    run(*pip, "check")
    place = run(str(programs / "python"), "-c", "import e4dgs; print(e4dgs.__file__)").strip()
    assert programs.parent in Path(place).parents, f"e4dgs comes from {place}"
    shutil.copytree(ROOT / "samples" / "cube_and_ball", folder / "cube_and_ball")
    print(run(str(programs / "e4dgs"), "run", "all", "cube_and_ball", *SAMPLE.split()))
    made = {path.name for path in (folder / "e4dgs-workspace" / "store").iterdir()}
    assert set(WANTED) <= made, f"the store has {sorted(made)}"
    assert (folder / "e4dgs-workspace" / "scenes" / "cube_and_ball" / "report.html").is_file()


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    wheel = Path(sys.argv[1]).resolve()
    check_contents(wheel)
    with tempfile.TemporaryDirectory() as scratch:
        check_use(wheel, Path(scratch))
    print(f"{wheel.name}: its files are right; it installs and runs the sample without a compiler")
