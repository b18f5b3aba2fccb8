"""Keeps compiled kernels on disk, so that only the first start on a machine compiles them.

A file consists of 20 bytes of digest, a line of JSON (form, resources), and the code. Its name is the digest of everything that
determines the code. Its content is checked before use: a truncated or corrupted file is compiled again and never loaded.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import tempfile
import threading
import warnings
from dataclasses import asdict
from pathlib import Path

from .compiler import FLAGS, Compiled, Resources, compile_cubin, nvrtc_version
from .program import Program, digest

FORMAT = 1
LIMIT = 512 * 2**20  # bytes; beyond this, the least recently used files are removed
SUFFIX = ".kernel"
CHECK = 20  # bytes of digest before the content

_MEMORY: dict[tuple[Program, str], Compiled] = {}
_LOCKS: dict[tuple[Program, str], threading.Lock] = {}
_WARNED: list[str] = []


def compiled(program: Program, arch: str) -> Compiled:
    """A program compiled for an architecture: from this process, else from disk, else compiled now and kept in both.

    Any thread may call this. One thread compiles, and others that need the same program wait. If the folder cannot be used, it warns
    once and keeps the code in this process only. Raises what `compile_cubin` raises.
    """
    key = program, arch
    found = _MEMORY.get(key)
    if found is None:
        with _LOCKS.setdefault(key, threading.Lock()):
            found = _MEMORY.get(key)
            if found is None:
                found = _MEMORY[key] = _from_disk(program, arch)
    return found


def folder() -> Path:
    """Where compiled kernels are kept: $E4DGS_CACHE, else e4dgs/kernels in $XDG_CACHE_HOME or ~/.cache.

    Raises RuntimeError if neither is set and there is no home folder.
    """
    if chosen := os.environ.get("E4DGS_CACHE"):
        return Path(chosen).expanduser()
    base = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(base) if os.path.isabs(base) else Path.home() / ".cache") / "e4dgs" / "kernels"


def usage() -> tuple[int, int]:
    """(files, bytes) in the folder; (0, 0) if there is no folder."""
    sizes = [size for _, _, size in _files(folder())]
    return len(sizes), sum(sizes)


def _from_disk(program: Program, arch: str) -> Compiled:
    name = _name(program, arch) + SUFFIX
    path: Path | None = None
    try:
        path = folder() / name
        found = _decode(path.read_bytes())
        if found is not None:
            with contextlib.suppress(OSError):  # another user's folder may be read-only
                os.utime(path)  # marks the file as recently used
            return found
    except FileNotFoundError:
        pass
    except (OSError, RuntimeError) as cause:
        _warn(cause)
        path = None
    new = compile_cubin(program, arch)
    if path is not None:
        try:
            _write(path, _encode(new))
        except OSError as cause:
            _warn(cause)
    return new


def _name(program: Program, arch: str) -> str:
    parts = [FORMAT, digest(program), arch, *FLAGS, *nvrtc_version()]
    return hashlib.blake2b("\0".join(map(str, parts)).encode(), digest_size=20).hexdigest()


def _encode(code: Compiled) -> bytes:
    about = {"form": code.form, "resources": {name: asdict(used) for name, used in code.resources.items()}}
    content = json.dumps(about).encode() + b"\n" + code.code
    return hashlib.blake2b(content, digest_size=CHECK).digest() + content


def _decode(data: bytes) -> Compiled | None:
    check, content = data[:CHECK], data[CHECK:]
    if hashlib.blake2b(content, digest_size=CHECK).digest() != check:
        return None
    line, _, code = content.partition(b"\n")
    about = json.loads(line)
    return Compiled(code, about["form"], {name: Resources(**used) for name, used in about["resources"].items()})


def _write(path: Path, data: bytes) -> None:
    """Writes a temporary file beside `path` and renames it, so that nobody reads half a file. Then removes the oldest files beyond the
    limit."""
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(dir=path.parent, suffix=".part")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
        os.replace(temporary, path)
    except BaseException:
        with contextlib.suppress(OSError):
            os.unlink(temporary)
        raise
    files = sorted(_files(path.parent))
    excess = sum(size for _, _, size in files) - LIMIT
    for _, old, size in files:
        if excess <= 0:
            break
        if old != path:
            with contextlib.suppress(OSError):  # another process was faster
                old.unlink()
            excess -= size


def _files(place: Path) -> list[tuple[float, Path, int]]:
    """(last use, path, bytes) of the files that this module has written, including those left by an interrupted process."""
    found = []
    with contextlib.suppress(OSError):
        for path in place.iterdir():
            if path.suffix in (SUFFIX, ".part"):
                with contextlib.suppress(OSError):
                    status = path.stat()
                    found.append((status.st_mtime, path, status.st_size))
    return found


def _warn(cause: Exception) -> None:
    if not _WARNED:
        _WARNED.append(str(cause))
        warnings.warn(
            f"compiled CUDA kernels cannot be kept on disk ({cause}), so every start compiles them again; set E4DGS_CACHE to a folder that "
            "can be written",
            stacklevel=2,
        )
