"""Mutual exclusion between processes: an exclusive lock on a file. The operating system frees it if its holder dies."""

from __future__ import annotations

import errno
import fcntl
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from ..errors import StageError

_POLL_SECONDS = 0.05  # the lock is polled, because a network file system may be slow to wake a waiting process
_NONE = (errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.EINVAL)
_TAKEN = (errno.EAGAIN, errno.EACCES)


@contextmanager
def locked(path: Path, wait: bool = True, waiting: Callable[[], object] | None = None) -> Iterator[bool]:
    """Yields True while holding the lock. With ``wait=False``, yields False at once if another process holds it. The lock file is created
    if needed and never removed.

    ``waiting()`` is called once before waiting for another holder. Raises StageError if the file system has no locks, OSError for any
    other failure.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    # Open for writing, because network file systems allow exclusive locks only on such files.
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
    """Whether somebody holds the lock now. This also works on a read-only file system.

    If the file system has no locks, there is no way to tell, and the lock counts as held.
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
                f"{path}: this file system has no locks ({error.strerror}), which keep runs from disturbing one another; give a "
                "--workspace on a local disk, or mount the network file system with locks (NFS: without nolock, its lock service running)"
            ) from error
        raise
    return True
