"""Copies a result from another store. Every byte is compared with the manifest before the result is accepted."""

from __future__ import annotations

import os
import shutil
import uuid
from pathlib import Path

from ..errors import DamagedError
from ..files import sync_file, sync_tree
from .artifact import MANIFEST, Artifact
from .store import Store


def adopt(store: Store, source: Artifact, stage: str, key: str) -> Artifact:
    """Links the files of ``source``, a result of another store, into this store, or copies those that cannot be linked. The caller must
    hold the key's lock.

    The source is only read. Raises DamagedError, naming the source's file, if it does not verify; OSError if it cannot be written.
    """
    folder = store.root / "tmp" / f"{stage}-{key}-{uuid.uuid4().hex[:8]}"
    target = store.path(stage, key)
    try:
        for name in source.manifest["files"]:
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            _link(source.path / name, folder / name)
        # The manifest is copied, never linked: its locks say who uses the result in this store, its mtime when it was last used.
        shutil.copyfile(source.path / MANIFEST, folder / MANIFEST)
        try:
            Artifact(folder).verify()
        except DamagedError as error:
            raise DamagedError(source.path, error.file, error.what) from None
        sync_tree(folder, [*source.manifest["files"], MANIFEST])
        target.parent.mkdir(parents=True, exist_ok=True)
        os.rename(folder, target)
        sync_file(target.parent)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    return Artifact(target)


def _link(source: Path, target: Path) -> None:
    try:
        os.link(source, target)
    except OSError:  # on another file system, or owned by another user
        shutil.copyfile(source, target)
