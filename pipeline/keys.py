"""Cache keys: everything that decides a stage's result, and nothing else (never a time stamp)."""

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
    """Relative name -> BLAKE3 of the content of each file of a capture. Raises CaptureError for one that cannot be read."""
    try:
        return digest_files(Path(capture.root), capture.files)
    except OSError as error:
        raise CaptureError(
            f"{error.filename or capture.root}: cannot be read ({error.strerror or error}); check the capture's files"
        ) from error


def capture_digest(capture: Capture) -> str:
    """BLAKE3 over the relative names and contents of all files of a capture. Raises CaptureError for a file that cannot be read."""
    return digest_of_files(capture_files(capture))


def digest_of_files(digests: Mapping[str, str]) -> str:
    """One digest of what `capture_files` found."""
    return digest_bytes(canonical_json(digests))


def settings_parts(settings: Settings) -> dict[str, Any]:
    """The settings as JSON; a ``Path`` field counts with the content of the file that it names."""
    parts = settings.model_dump(mode="json")
    for name in type(settings).model_fields:
        value = getattr(settings, name)
        if isinstance(value, Path):
            parts[name] = {"file": _file_digest(name, value)}
    return parts


def _file_digest(name: str, path: Path) -> str:
    if not os.path.isfile(path):
        raise SettingsError(f"{name}={path}: there is no such file")
    try:
        return digest_file(path)
    except OSError as error:
        raise SettingsError(f"{name}={path}: cannot be read ({error.strerror})") from error


def key_parts(stage: Stage, settings: Settings, inputs: Mapping[str, str | None], capture: str | None, device: str) -> dict[str, Any]:
    """What a stage's result depends on, as JSON.

    ``inputs`` maps input stages to the content digests of their artifacts (None: skipped). Content, not keys: an input that was
    made again and came out equal leaves this key as it was, and the rerun stops there. ``code`` also has the digest of each source file,
    for people. Raises StageError for a stage whose source cannot be found.
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
    """32 hex digits that name a result in the store."""
    return digest_bytes(canonical_json(deciding(parts)))[:32]


def deciding(parts: Mapping[str, Any]) -> dict[str, Any]:
    """Key parts without the names of source files: one that merely moves changes no key."""
    return {**parts, "code": parts["code"]["digest"]} if "code" in parts else dict(parts)
