"""Taking a result over from another store: every byte is compared with its manifest before it counts."""

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
    """Links the files of ``source``, a result of another store, into this one, or copies them where that cannot be. Hold the key's lock.

    The source is only read. Raises DamagedError that names the source's file where it does not verify; OSError where it cannot be written.
    """
    folder = store.root / "tmp" / f"{stage}-{key}-{uuid.uuid4().hex[:8]}"
    target = store.path(stage, key)
    try:
        for name in source.manifest["files"]:
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            _link(source.path / name, folder / name)
        # Copied, never linked: it carries who uses the result in this store, and when it was used last.
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
    except OSError:  # another file system, or a file of somebody else
        shutil.copyfile(source, target)
