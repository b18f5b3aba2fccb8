"""Atomic file writes, and digests of files."""

import json
import os
import tempfile
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from blake3 import blake3

from .machine.threads import thread_count, waiting_threads

_FEW, _SMALL = 16, 1 << 20  # up to this many files, of up to this many bytes each, starting threads would not pay off


def canonical_json(value: Any) -> bytes:
    """JSON bytes that are identical for equal values: sorted keys, no spaces."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=False).encode()


def digest_bytes(data: bytes) -> str:
    """BLAKE3, 64 hex digits."""
    return blake3(data).hexdigest()


def digest_file(path: Path) -> str:
    """BLAKE3 of a file's content, 64 hex digits. Raises OSError."""
    if os.path.getsize(path) > _SMALL:
        return blake3(max_threads=thread_count()).update_mmap(path).hexdigest()
    with open(path, "rb") as file:
        return blake3(file.read()).hexdigest()


def digest_files(root: Path, files: Iterable[str | Path]) -> dict[str, str]:
    """Relative name (``/`` as separator) -> digest, in sorted order. Uses threads if there are enough files or large ones."""
    names = sorted(Path(file).as_posix() for file in files)
    if len(names) <= _FEW and all(os.path.getsize(root / name) <= _SMALL for name in names):
        return {name: digest_file(root / name) for name in names}
    with ThreadPoolExecutor(waiting_threads()) as pool:
        return dict(zip(names, pool.map(lambda name: digest_file(root / name), names)))


def sizes(root: Path) -> dict[str, int]:
    """Relative name -> size in bytes of every file below ``root``. A link or device counts as -1, which matches no size."""
    found: dict[str, int] = {}
    pending = [("", str(root))]
    while pending:
        prefix, folder = pending.pop()
        with os.scandir(folder) as entries:
            for entry in entries:
                if entry.is_dir(follow_symlinks=False):
                    pending.append((f"{prefix}{entry.name}/", entry.path))
                else:
                    regular = entry.is_file(follow_symlinks=False)
                    found[prefix + entry.name] = entry.stat(follow_symlinks=False).st_size if regular else -1
    return found


def bytes_in(root: Path) -> int:
    """Bytes of all files below ``root``, links aside; 0 if it has gone."""
    with suppress(OSError):
        return sum(max(0, size) for size in sizes(root).values())
    return 0


def sync_file(path: Path) -> None:
    """Calls fsync on a file or on a folder (its directory entries)."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def sync_tree(root: Path, files: Iterable[str]) -> None:
    """fsync of the given files and of every folder below and including ``root``."""
    with ThreadPoolExecutor(waiting_threads()) as pool:
        list(pool.map(lambda name: sync_file(root / name), files))
    for folder, _, _ in os.walk(root):
        sync_file(Path(folder))


def write_atomically(path: Path, data: bytes | str) -> None:
    """Replaces ``path`` in one step: readers see either the old or the new content, never a part of it, even after a crash."""
    path.parent.mkdir(parents=True, exist_ok=True)
    descriptor, temporary = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(data.encode() if isinstance(data, str) else data)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except BaseException as error:
        Path(temporary).unlink(missing_ok=True)
        if isinstance(error, OSError) and error.filename is None:
            error.filename = str(path)  # the error of a failed write does not name the file
        raise
    sync_file(path.parent)


@contextmanager
def written_beside(path: Path) -> Iterator[Path]:
    """For writers that want a file: a free name beside ``path`` with its suffix. In the end it takes the place of ``path`` in
    one step; after an error nothing stays. The folder is made if it does not exist."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.stem}-{os.getpid()}{path.suffix}")
    part.unlink(missing_ok=True)
    try:
        yield part
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)


def write_json(path: Path, value: Any) -> None:
    """Indented JSON, written atomically. NaN is not JSON and raises ValueError."""
    write_atomically(path, json.dumps(value, indent=2, ensure_ascii=False, allow_nan=False) + "\n")


def read_json(path: Path) -> Any:
    """The content of a JSON file, or None if the file cannot be read or is not JSON."""
    try:
        return json.loads(path.read_bytes())
    except (OSError, ValueError):
        return None
