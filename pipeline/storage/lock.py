"""The right to do something alone, across processes: an exclusive lock on a file, which the system frees when its holder dies."""

from __future__ import annotations

import errno
import fcntl
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from ..errors import StageError

_POLL_SECONDS = 0.05  # asked again and again: a network file system may take long to wake who waits
_NONE = (errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.EINVAL)
_TAKEN = (errno.EAGAIN, errno.EACCES)


@contextmanager
def locked(path: Path, wait: bool = True, waiting: Callable[[], object] | None = None) -> Iterator[bool]:
    """True with the lock; without ``wait`` False at once, and no lock, where another holds it. The file is made and stays.

    ``waiting()`` is called once when another holds it. Raises StageError where the file system has no locks, OSError for what else fails.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    # Open for writing, since network file systems lock alone only such files.
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    try:
        free = _try(descriptor, path)
        if not free and wait:
            if waiting is not None:
                waiting()
            while not (free := _try(descriptor, path)):
                time.sleep(_POLL_SECONDS)
        yield free
    finally:
        os.close(descriptor)


def is_locked(path: Path) -> bool:
    """Whether somebody holds the lock now. It works on a read-only file system, too.

    Where the file system has no locks nobody can tell, which counts as held.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    except FileNotFoundError:
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError:
        return True
    finally:
        os.close(descriptor)
    return False


def _try(descriptor: int, path: Path) -> bool:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in _TAKEN:
            return False
        if error.errno in _NONE:
            raise StageError(
                f"{path}: this file system has no locks ({error.strerror}), by which runs keep out of one another's way; give a "
                "--workspace on a local disk, or mount the network file system with locks (NFS: without nolock, its lock service running)"
            ) from error
        raise
    return True
