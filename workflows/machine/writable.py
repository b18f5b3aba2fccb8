"""Read-only or full workspaces: reading them works, and a command that must write ends with one clear message."""

from __future__ import annotations

import errno
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ...pipeline import StageError
from ...pipeline.storage.room import said_when_full

_FORBIDDEN = (errno.EROFS, errno.EACCES, errno.EPERM)


@contextmanager
def writing_to(workspace: Path) -> Iterator[None]:
    """Raises StageError if the block fails because the workspace, or something in it, cannot be written or has no room."""
    try:
        with said_when_full(workspace):
            yield
    except OSError as error:
        place = Path(str(error.filename or workspace))
        if error.errno not in _FORBIDDEN or not place.is_relative_to(workspace):
            raise
        advice = "give another --workspace"
        if (workspace / "store").is_dir():
            advice = (
                f"results in {workspace} can be read: {advice}, and to `run`, `plan` and `batch` --store-also {workspace}, to take them "
                "from there"
            )
        raise StageError(f"{place}: cannot be written ({error.strerror}), and this command has to; {advice}") from error
