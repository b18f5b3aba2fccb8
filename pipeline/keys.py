"""Cache keys. A key covers everything that determines a stage's result and nothing else; in particular, no time stamps."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from .code.reach import code_of
from .errors import CaptureError, SettingsError
from .files import canonical_json, digest_bytes, digest_file, digest_files
from .settings import Settings
from .stage import Capture, Stage


def capture_files(capture: Capture) -> dict[str, str]:
    """Relative name -> BLAKE3 digest of the content, for each file of a capture. Raises CaptureError if a file cannot be read."""
    try:
        return digest_files(Path(capture.root), capture.files)
    except OSError as error:
        raise CaptureError(
            f"{error.filename or capture.root}: cannot be read ({error.strerror or error}); check the capture's files"
        ) from error


def digest_of_files(digests: Mapping[str, str]) -> str:
    """One digest of the mapping that `capture_files` returns."""
    return digest_bytes(canonical_json(digests))


def settings_parts(settings: Settings) -> dict[str, Any]:
    """The settings as JSON. A ``Path`` field is represented by the content digest of the file or folder it names."""
    parts = settings.model_dump(mode="json")
    for name in type(settings).model_fields:
        value = getattr(settings, name)
        if isinstance(value, Path):
            parts[name] = {"folder": _folder_digest(name, value)} if os.path.isdir(value) else {"file": _file_digest(name, value)}
    return parts


def _file_digest(name: str, path: Path) -> str:
    if not os.path.isfile(path):
        raise SettingsError(f"{name}={path}: there is no such file")
    try:
        return digest_file(path)
    except OSError as error:
        raise SettingsError(f"{name}={path}: cannot be read ({error.strerror})") from error


def _folder_digest(name: str, path: Path) -> str:
    """Of the names and contents of the files right in the folder; hidden ones do not count."""
    try:
        files = sorted(file for file in os.listdir(path) if not file.startswith(".") and os.path.isfile(path / file))
        return digest_of_files(digest_files(path, files))
    except OSError as error:
        raise SettingsError(f"{name}={path}: {error.filename or path} cannot be read ({error.strerror})") from error


def key_parts(stage: Stage, settings: Settings, inputs: Mapping[str, str | None], capture: str | None, device: str) -> dict[str, Any]:
    """Everything that a stage's result depends on, as JSON.

    ``inputs`` maps input stages to the content digests of their artifacts (None: skipped). Contents are used rather than keys, so that an
    input that was recomputed with an identical result leaves this key unchanged and the rerun stops there. ``code`` also lists the digest
    of each source file, for display only. Raises StageError for a stage whose source cannot be found.
    """
    parts: dict[str, Any] = {
        "stage": stage.name,
        "code": code_of(type(stage), stage.device_class and device == "cuda"),
        "settings": settings_parts(settings),
        "inputs": {name: inputs[name] for name in stage.inputs},
    }
    if stage.reads_capture:
        parts["capture"] = capture
    if stage.device_class:
        parts["device"] = device
    return parts


def key_of(parts: Mapping[str, Any]) -> str:
    """The 32 hex digits that name a result in the store."""
    return digest_bytes(canonical_json(deciding(parts)))[:32]


def deciding(parts: Mapping[str, Any]) -> dict[str, Any]:
    """Key parts without the list of source files, so that moving a file does not change a key."""
    return {**parts, "code": parts["code"]["digest"]} if "code" in parts else dict(parts)
