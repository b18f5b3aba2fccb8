"""A process that uses an artifact holds a shared lock on its manifest. The operating system frees the lock if the process dies.

This works on read-only file systems and needs no extra files. To remove an artifact, take an exclusive lock on the same file (`alone`).
"""

from __future__ import annotations

import fcntl
import os
import weakref
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

Mark = tuple[int, int]  # device and inode of the manifest


def hold(owner: object, manifest: Path) -> tuple[bytes, Mark]:
    """Reads a manifest and holds it until ``owner`` is garbage-collected. Raises OSError, most often FileNotFoundError.

    If the file system has no locks, the content is read anyway: nothing can be removed there, because `alone` raises.
    """
    while True:
        descriptor = os.open(manifest, os.O_RDONLY | os.O_CLOEXEC)
        try:
            with suppress(OSError):
                fcntl.flock(descriptor, fcntl.LOCK_SH)
            mark = _mark(os.fstat(descriptor))
            if is_held_at(mark, manifest):  # otherwise it was moved away between opening and locking
                content = _read(descriptor)
                weakref.finalize(owner, os.close, descriptor)
                descriptor = -1
                return content, mark
        finally:
            if descriptor >= 0:
                os.close(descriptor)


def is_held_at(mark: Mark, manifest: Path) -> bool:
    """Whether the manifest that is held is still the one at this path."""
    try:
        return _mark(os.stat(manifest)) == mark
    except FileNotFoundError:
        return False


@contextmanager
def alone(manifest: Path) -> Iterator[bool]:
    """Yields True if nobody else holds the artifact; then nobody can start to until the block ends. Yields False, without waiting, if
    somebody does. An artifact without a manifest is held by nobody.

    Raises OSError if it cannot be locked.
    """
    try:
        descriptor = os.open(manifest, os.O_RDWR | os.O_CLOEXEC)  # network file systems lock exclusively only files open for writing
    except FileNotFoundError:
        yield True
        return
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            yield False
            return
        yield True
    finally:
        os.close(descriptor)


def _mark(found: os.stat_result) -> Mark:
    return found.st_dev, found.st_ino


def _read(descriptor: int) -> bytes:
    parts = []
    while part := os.read(descriptor, 1 << 20):
        parts.append(part)
    return b"".join(parts)
