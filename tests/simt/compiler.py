"""Kernel sources to shared libraries, kept in a folder under a digest of all that goes into them.

A source is preprocessed with `simt.h` in CUDA's place, the table of its kernels is written below it, and both are compiled and linked
with the emulator's run time. The folder is `build/simt`, or the one in E4DGS_SIMT_DIR; processes may share it.
"""

from __future__ import annotations

import hashlib
import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Protocol

import pytest

from .error import SimtError
from .table import table

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
RUNTIME = ("scheduler.cpp", "report.cpp", "races.cpp", "hooks.cpp", "launch.cpp")
FLAGS = ("-std=c++20", "-O2", "-fPIC", "-fvisibility=hidden", "-ffp-contract=off", "-fno-strict-aliasing", "-Wno-attributes")
FLAGS += ("-Werror=frame-larger-than=65536", "-gdwarf-4")  # of version 5, addr2line of 2022 confuses the files
if platform.machine() in ("x86_64", "AMD64"):
    FLAGS += ("-mno-mmx",)  # GCC 12 kept a value in an MMX register; after that x87 code, as in OpenBLAS, gives NaN
# For Emulator(flags=CHECKED), with GCC: arrays' bounds, alignment, integer overflow, and conversions that saturate on a GPU end a launch
# where they stand, at hardly more time.
CHECKED = ("-fsanitize=undefined,float-cast-overflow", "-fsanitize-undefined-trap-on-error", "-fno-crossjumping", "-fno-tree-tail-merge")
# For Emulator(flags=RACES), with GCC: accesses that nothing orders (races.h) end a launch, whatever the order they came in, at about ten
# times the time. Of the sanitizer only what it adds to the code is used.
RACES = ("-fsanitize=thread", "--param=tsan-distinguish-volatile=1")
INCLUDE = re.compile(r'^\s*#\s*include\s*[<"]([^>"]+)[>"]', re.MULTILINE)


class Program(Protocol):
    """What is compiled as one: a .cu file with macros and folders of headers."""

    @property
    def source(self) -> Path: ...
    @property
    def defines(self) -> tuple[tuple[str, int], ...]: ...
    @property
    def includes(self) -> tuple[Path, ...]: ...


def command() -> list[str]:
    return (os.environ.get("CXX") or "g++").split()


def why_not() -> str:
    """Why kernels cannot be compiled here, or nothing."""
    if sys.platform != "linux":
        return f"the emulator needs Linux, and this is {sys.platform}"
    return "" if shutil.which(command()[0]) else f"the emulator needs a C++20 compiler, and there is no {command()[0]} (see $CXX)"


needs_compiler = pytest.mark.skipif(bool(why_not()), reason=why_not())


def compile(program: Program, flags: tuple[str, ...] = ()) -> Path:
    """The shared library of a program, compiled unless the folder has it. `flags` are given to the compiler after its usual ones.

    Raises SimtError with what the compiler says.
    """
    source = program.source.resolve()
    options = [*FLAGS, f"-I{HERE}", *(f"-I{include}" for include in program.includes)]
    options += ["-DE4DGS_EMULATED", *(f"-D{name}={value}" for name, value in program.defines), *flags]
    target = folder() / f"{source.stem}-{digest({*closure(source, program.includes), *own_files()}, options)}.so"
    if target.exists():
        os.utime(target)
    else:
        remove_unused()
        runtime = compile_runtime(flags)
        with becoming(target) as result:
            wrapper, text = result.with_suffix(".cpp"), result.with_suffix(".ii")
            # In a namespace without a name, so that no other library of the process can share anything of it.
            wrapper.write_text(f'namespace {{\n#include "{source}"\n}}\n')
            run([*options, "-include", "simt.h", "-include", "table.h", "-E", str(wrapper), "-o", str(text)])
            preprocessed = text.read_text()
            text.write_text(preprocessed + table(preprocessed, source))
            run([*options, "-c", str(text), "-o", str(result.with_suffix(".o"))])
            linked = [flag for flag in flags if flag != "-fsanitize=thread"]
            run([*linked, "-shared", str(result.with_suffix(".o")), str(runtime), "-o", str(result)])
    return target


def compile_runtime(flags: tuple[str, ...]) -> Path:
    """The part of the emulator that no kernel changes, as one object file. Of the flags it takes macros, and nothing that checks."""
    options = [*FLAGS, *(flag for flag in flags if flag.startswith("-D"))]
    target = folder() / f"runtime-{digest(own_files(), options)}.o"
    if not target.exists():
        with becoming(target) as result:
            whole = result.with_suffix(".cpp")
            whole.write_text("".join(f'#include "{HERE / name}"\n' for name in RUNTIME))
            run([*options, "-c", str(whole), "-o", str(result)])
    return target


def folder() -> Path:
    return Path(os.environ.get("E4DGS_SIMT_DIR") or ROOT / "build" / "simt").resolve()


def remove_unused(days: float = 3) -> None:
    """Each edit of a kernel leaves libraries behind that nobody asks for again."""
    for path in folder().glob("*.so"):
        with suppress(OSError):  # another process does the same
            if path.stat().st_mtime < time.time() - days * 86400:
                path.unlink()


def own_files() -> set[Path]:
    return {*HERE.glob("*.h"), *HERE.glob("*.cpp"), HERE / "compiler.py", HERE / "table.py"}


def closure(source: Path, includes: tuple[Path, ...]) -> set[Path]:
    """The source and all it includes from its own folder and these, whatever the macros say."""
    found: set[Path] = set()
    rest = [source]
    while rest:
        path = rest.pop()
        if path not in found and path.is_file():
            found.add(path)
            rest += [(near / name).resolve() for name in INCLUDE.findall(path.read_text()) for near in (path.parent, *includes)]
    return found


def digest(sources: set[Path], options: list[str]) -> str:
    """Of the sources' places too, which errors name."""
    state = hashlib.sha256("\0".join([compiler_version(*command()), *options]).encode())
    for path in sorted(sources):
        state.update(f"\0{path}\0".encode() + path.read_bytes())
    return state.hexdigest()[:20]


@cache
def compiler_version(*_: str) -> str:
    return run(["--version"])


@contextmanager
def becoming(target: Path) -> Iterator[Path]:
    """A path in a folder of its own, whose file is moved to `target` at the end: others see all of it or nothing."""
    target.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=target.parent) as work:
        result = Path(work) / target.name
        yield result
        os.replace(result, target)


def run(options: list[str]) -> str:
    """Call the compiler; returns what it prints."""
    if why_not():
        raise SimtError(why_not())
    done = subprocess.run([*command(), *options], capture_output=True, text=True)
    if done.returncode:
        raise SimtError(f"{' '.join(command())} says:\n{done.stderr[:20000]}")
    return done.stdout
