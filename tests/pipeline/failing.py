"""Makes the nth call that changes something on disk fail, as SQLite's tests do: the disk is full, or the process dies there."""

import builtins
import contextlib
import io
import os
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

CALLS = ("fsync", "rename", "replace", "mkdir", "rmdir", "link", "unlink", "utime")


class Crash(BaseException):
    """The process ends here: nothing that it would have cleaned up is cleaned up."""


class FailNth:
    """Below ``root`` the nth call of `CALLS`, or of an open that writes or creates, raises ``error``; after a Crash all of them do."""

    def __init__(self, n: int, error: BaseException, root: Path) -> None:
        self.left, self.failed, self.error, self.root, self._lock = n, False, error, str(root), threading.Lock()

    @contextlib.contextmanager
    def patched(self) -> Iterator["FailNth"]:
        with pytest.MonkeyPatch.context() as patch:
            for name in CALLS:
                patch.setattr(os, name, self._wrap(getattr(os, name)))
            plain, system = io.open, os.open
            for module in (io, builtins):
                patch.setattr(module, "open", self._wrap(plain, lambda mode="r", *_, **__: not {*mode} & {*"wxa+"}))
            patch.setattr(os, "open", self._wrap(system, lambda flags, *_, **__: not flags & os.O_CREAT))
            yield self

    def _wrap(self, original, harmless=lambda *_, **__: False):
        def call(*args, **kwargs):
            if harmless(*args[1:], **kwargs) or not self._is_ours(args[0], kwargs.get("dir_fd")):
                return original(*args, **kwargs)
            with self._lock:
                self.left -= 1
                dead = self.left < 0 and isinstance(self.error, Crash)  # a dead process does nothing any more
                fail = self.left == 0 or dead
            if fail:
                self.failed = True
                raise type(self.error)(*self.error.args)  # a new one each time: an old one would keep what its frames hold
            return original(*args, **kwargs)

        return call

    def _is_ours(self, target: object, folder: int | None) -> bool:
        known = folder if folder is not None else target
        try:
            place = os.readlink(f"/proc/self/fd/{known}") if isinstance(known, int) else os.fspath(known)
        except (TypeError, OSError):
            return True
        return str(place).startswith(self.root)
