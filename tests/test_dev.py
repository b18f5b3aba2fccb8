"""The developer entry point: messages a newcomer can act on, and no work where nothing changed. Nothing is installed here."""

import json
import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest
from script_module import load_script

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture
def dev(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> ModuleType:
    """dev.py as a module, with its environment in a temporary folder."""
    monkeypatch.setenv("E4DGS_VENV", str(tmp_path / "venv"))
    return load_script(ROOT / "dev.py")


def call(*arguments: str, **environment: str) -> subprocess.CompletedProcess:
    command = [sys.executable, str(ROOT / "dev.py"), *arguments]
    return subprocess.run(command, env={**os.environ, **environment}, capture_output=True, text=True, timeout=60)


@pytest.mark.parametrize("arguments", [(), ("smaple",)])
def test_without_a_command_it_says_what_there_is(arguments):
    result = call(*arguments)
    assert result.returncode == 2
    assert "dev.py sample" in result.stdout and "dev.py test" in result.stdout


def test_without_a_compiler_it_says_which_package_to_install(tmp_path):
    result = call("setup", PATH=str(tmp_path), CXX="", E4DGS_VENV=str(tmp_path / "venv"))
    assert result.returncode == 1
    assert "apt install g++" in result.stderr and "Traceback" not in result.stderr
    assert not (tmp_path / "venv").exists()


def test_it_never_clears_a_folder_that_is_no_environment(dev, tmp_path):
    (tmp_path / "venv").mkdir()
    (tmp_path / "venv" / "thesis.tex").write_text("years of work")
    with pytest.raises(SystemExit, match="is not a Python environment"):
        dev.create_venv()
    assert (tmp_path / "venv" / "thesis.tex").exists()


def test_an_old_python_is_told_so(dev, monkeypatch):
    monkeypatch.setattr(dev.sys, "version_info", (3, 9, 2))
    with pytest.raises(SystemExit, match=r"3\.11 or newer, and this is 3\.9"):
        dev.check_python()


def test_an_environment_is_reused_only_with_the_same_inputs_and_extras(dev, tmp_path):
    assert not dev.is_installed("a", dev=False)
    (tmp_path / "venv").mkdir()
    dev.STAMP.write_text(json.dumps({"inputs": "a", "dev": False}))
    assert dev.is_installed("a", dev=False)
    assert not dev.is_installed("b", dev=False)
    assert not dev.is_installed("a", dev=True)
    dev.STAMP.write_text(json.dumps({"inputs": "a", "dev": True}))
    assert dev.is_installed("a", dev=False) and dev.is_installed("a", dev=True)
    dev.STAMP.write_text('{"inputs": "a", "d')
    assert not dev.is_installed("a", dev=False)


def test_pins_native_sources_and_packages_decide_about_a_new_install_and_the_text_of_python_files_does_not(dev, monkeypatch, tmp_path):
    checkout = tmp_path / "checkout"
    (checkout / "rasterizer" / "cpu").mkdir(parents=True)
    for name in dev.BUILD_INPUTS:
        (checkout / name).parent.mkdir(parents=True, exist_ok=True)
        (checkout / name).write_text("x")
    kernel, module = checkout / "rasterizer" / "cpu" / "blend.cpp", checkout / "rasterizer" / "types.py"
    kernel.write_text("1")
    module.write_text("1")
    monkeypatch.setattr(dev, "ROOT", checkout)
    before = dev.build_digest()
    module.write_text("2")
    assert dev.build_digest() == before
    kernel.write_text("2")
    changed = dev.build_digest()
    assert changed != before
    (checkout / "constraints.txt").write_text("y")
    pinned = dev.build_digest()
    assert pinned != changed
    (checkout / "rasterizer" / "cpu" / "__init__.py").write_text("")  # an editable install knows which names are modules, which packages
    assert dev.build_digest() != pinned


@pytest.fixture
def sanitized(dev, monkeypatch, tmp_path):
    """`dev.sanitize` with commands recorded instead of run; they succeed unless `failing` names a word of theirs."""
    commands, failing = [], []

    def run(command, environment=None, folder=None):
        commands.append((command, environment))
        return int(any(word in command for word in failing))

    monkeypatch.setattr(dev, "run", run)
    monkeypatch.setattr(dev, "SANITIZED", tmp_path / "sanitize")
    monkeypatch.setattr(dev, "sanitizer_libraries", lambda: ["/lib/libasan.so.8", "/lib/libubsan.so.1"])
    (tmp_path / "sanitize").mkdir()
    return dev, commands, failing


def test_sanitize_builds_beside_the_environment_once_and_tests_what_it_built(sanitized, tmp_path):
    dev, commands, _ = sanitized
    assert dev.sanitize([]) == 0
    (build, build_environment), (tests, environment) = commands
    assert build[build.index("--target") + 1] == str(tmp_path / "sanitize" / "package") and "--editable" not in build
    assert "cmake.define.E4DGS_SANITIZE=" + dev.SANITIZERS in build
    assert build_environment["SKBUILD_BUILD_DIR"] == str(tmp_path / "sanitize" / "cmake")
    assert environment["LD_PRELOAD"] == "/lib/libasan.so.8:/lib/libubsan.so.1"
    assert environment["E4DGS_SANITIZED"] == str(tmp_path / "sanitize" / "package")
    assert environment["PYTHONPATH"].split(os.pathsep)[0] == str(ROOT / "tests" / "sanitizers")
    for path in dev.SANITIZED_TESTS:
        assert path in tests and (ROOT / path).exists()
    commands.clear()
    dev.sanitize(["-k", "hull"])
    assert [command[-2:] for command, _ in commands] == [["-k", "hull"]]


def test_sanitize_fails_where_the_build_or_a_test_does(sanitized, tmp_path):
    dev, _, failing = sanitized
    failing.append("pytest")
    assert dev.sanitize([]) == 1
    failing[:] = ["pip"]
    (tmp_path / "sanitize" / "built.json").unlink()
    with pytest.raises(SystemExit, match="instrumented build failed"):
        dev.sanitize([])
    assert not (tmp_path / "sanitize" / "built.json").exists()


def test_sanitize_without_gcc_says_so(dev, monkeypatch):
    for compiler in ("true", "no-such-compiler"):
        monkeypatch.setenv("CXX", compiler)
        with pytest.raises(SystemExit, match=r"GCC's libasan\.so.*set CXX"):
            dev.sanitizer_libraries()


def test_every_process_of_sanitize_imports_the_instrumented_modules_and_all_else_as_usual(tmp_path):
    for floor, name in (("rasterizer", "_cpu"), ("scene", "_kernels"), ("vision", "_kernels")):
        folder = tmp_path / "e4dgs" / floor
        folder.mkdir(parents=True)
        (folder / f"{name}.py").write_text("")
    program = (
        "import e4dgs.rasterizer._cpu as a, e4dgs.scene._kernels as b, e4dgs.vision._kernels as c, e4dgs.rasterizer.types as d\n"
        "print(a.__file__, b.__file__, c.__file__, d.__file__)"
    )
    environment = {**os.environ, "E4DGS_SANITIZED": str(tmp_path), "PYTHONPATH": str(ROOT / "tests" / "sanitizers")}
    result = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True, timeout=60)
    assert result.returncode == 0, result.stderr
    *native, other = (Path(path) for path in result.stdout.split())
    assert len(native) == 3 and all(tmp_path in path.parents for path in native) and tmp_path not in other.parents


def test_every_direct_dependency_is_pinned():
    import tomllib

    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    wanted = [
        *project["project"]["dependencies"],
        *project["project"]["optional-dependencies"]["dev"],
        *project["build-system"]["requires"],
    ]
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pinned = {line.split("==")[0].lower().replace("_", "-") for line in lines if "==" in line}
    for requirement in wanted:
        name = requirement.split(";")[0].split(">")[0].strip().lower().replace("_", "-")
        assert name in pinned, f"constraints.txt lacks {name}"
    assert all("/" not in line and not line.startswith("-") for line in lines if not line.startswith("#"))


def test_the_whole_suite_runs_on_all_cores_and_a_part_of_it_on_one(dev, monkeypatch):
    commands = []
    monkeypatch.setattr(dev, "run", lambda command, environment=None: commands.append((command, environment)) or 0)
    for words in ([], ["-k", "hull"], ["tests/test_dev.py::test_dev"], ["--kernels=cuda", "tests/stress"]):
        assert dev.test(words) == 0
    assert ["--numprocesses" in command for command, _ in commands] == [True, True, False, False]
    assert commands[1][0][-2:] == ["-k", "hull"]
    assert all(environment["GOMP_SPINCOUNT"] for _, environment in commands)


def git(folder: Path, *words: str) -> str:
    told = ["-c", "user.name=a", "-c", "user.email=a@example.org", "-c", "commit.gpgsign=false"]
    return subprocess.run(["git", *told, *words], cwd=folder, check=True, capture_output=True, text=True).stdout.strip()


@pytest.fixture
def history(dev, monkeypatch, tmp_path):
    """A repository in which a commit without any form came before the check began; the function adds another."""
    folder = tmp_path / "history"
    folder.mkdir()
    git(folder, "init", "-q")
    git(
        folder,
        "commit",
        "-q",
        "--allow-empty",
        "-m",
        "fixed stuff, and a lot more, in a line that is far too long for anybody to read it whole.",
    )
    monkeypatch.setattr(dev, "CHECKED_SINCE", git(folder, "rev-parse", "HEAD"))
    monkeypatch.setattr(dev, "ROOT", folder)

    def commit(message: str) -> int:
        git(folder, "commit", "-q", "--allow-empty", "--cleanup=verbatim", "-m", message)
        return dev.commits()

    return commit


def test_commits_in_form_and_those_from_before_the_check_pass(dev, history, capsys):
    assert dev.commits() == 0
    assert history("Use one mechanism for files that are not read\n\nThe why, in a body of any length.\n") == 0
    assert history("Address the last needs of seeds: " + "x" * 39) == 0, "72 characters, and words that end as verbs do"
    assert capsys.readouterr().out.splitlines()[-1] == "commit messages: all in form"


@pytest.mark.parametrize(
    ("message", "problem"),
    [
        ("Use " + "x" * 69, "has 73 characters"),
        ("use lower case", "capital letter"),
        ("Use a full stop.", "full stop"),
        ("Added a thing", "not imperative"),
        ("Use one line\nor another", "second line is not blank"),
    ],
)
def test_a_commit_out_of_form_is_named(history, capsys, message, problem):
    assert history(message) == 1
    (line,) = capsys.readouterr().out.splitlines()
    assert problem in line and message.splitlines()[0] in line


def test_without_the_history_commits_are_not_checked_and_it_says_so(dev, history, monkeypatch, tmp_path, capsys):
    history("wrong but out of reach")
    git(tmp_path, "clone", "-q", "--depth", "1", (tmp_path / "history").as_uri(), "shallow")
    for folder in ("shallow", "venv"):
        (tmp_path / folder).mkdir(exist_ok=True)
        monkeypatch.setattr(dev, "ROOT", tmp_path / folder)
        capsys.readouterr()
        assert dev.commits() == 0 and "not checked" in capsys.readouterr().out
