"""The folder of a scene in a workspace, and which capture it belongs to."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from ..pipeline import Records, SettingsError
from ..pipeline.files import digest_bytes, read_json, write_json

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")


@dataclass(frozen=True)
class Scene:
    """``scenes/<name>/`` of a workspace. Nothing is created until `claim`."""

    name: str
    folder: Path
    capture: Path
    renamed: bool = False  # the capture's own name was taken by another capture

    @property
    def records(self) -> Records:
        return Records(self.folder / "records")

    def claim(self) -> None:
        """Records which capture the folder belongs to."""
        if read_json(self.folder / "capture.json") != {"path": str(self.capture)}:
            write_json(self.folder / "capture.json", {"path": str(self.capture)})


def find_scene(workspace: Path, capture: Path, own_name: str, chosen: str | None) -> Scene:
    """The scene of a capture (an absolute path): ``chosen``, or the capture's own name made safe for a folder.

    Two captures of the same name never share a folder. Without ``chosen``, the second is called ``name-<6 hex digits of its path>``.
    Raises SettingsError if ``chosen`` belongs to another capture.
    """
    scenes = workspace / "scenes"
    if chosen is not None:
        if not _NAME.fullmatch(chosen):
            raise SettingsError(f"--name {chosen}: use up to 100 letters, digits, '.', '_' and '-', a letter or digit first")
        owner = _owner(scenes / chosen)
        if owner not in (None, str(capture)):
            raise SettingsError(f"--name {chosen}: this scene belongs to {owner}; choose another --name, or remove {scenes / chosen}")
        return Scene(chosen, scenes / chosen, capture)
    name = re.sub(r"[^A-Za-z0-9._-]+", "-", own_name).strip("-._")[:80] or "capture"
    if _owner(scenes / name) in (None, str(capture)):
        return Scene(name, scenes / name, capture)
    name = f"{name}-{digest_bytes(str(capture).encode())[:6]}"
    return Scene(name, scenes / name, capture, renamed=True)


def _owner(folder: Path) -> str | None:
    """Path of the capture that a scene's folder belongs to, or None if the folder is free."""
    claim = read_json(folder / "capture.json")
    if isinstance(claim, dict) and isinstance(claim.get("path"), str):
        return claim["path"]
    return "an unknown capture" if folder.exists() and any(folder.iterdir()) else None
