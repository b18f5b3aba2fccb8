"""The folder of a scene in a workspace, and which capture it belongs to."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path

from ..pipeline import Records, SettingsError
from ..pipeline.files import digest_bytes, read_json, write_json
from ..pipeline.names import RULE, is_safe, safe_name
from ..pipeline.storage.lock import locked

CLAIM = "capture.json"  # names the capture that a scene's folder belongs to


class NameTakenError(SettingsError):
    """The name that was chosen for a scene belongs to another capture. owner: that capture's path."""

    def __init__(self, name: str, owner: str, folder: Path) -> None:
        super().__init__(f"--name {name}: this scene belongs to {owner}; choose another --name, or remove {folder}")
        self.owner, self.folder = owner, folder


@dataclass(frozen=True)
class Scene:
    """``scenes/<name>/`` of a workspace. Nothing is created until `claim`."""

    name: str
    folder: Path
    capture: Path
    chosen: bool = False  # the name is the value of --name
    renamed: bool = False  # the capture's own name was taken by another capture
    gone: str | None = None  # the path of a capture that is not there any more, which has this name, or the own name of a renamed one
    made: tuple[int, int] | None = None  # identifies the file with which this process claimed a free folder

    @property
    def records(self) -> Records:
        return Records(self.folder / "records")

    @property
    def own_name(self) -> str:
        """The capture's own name, also if the scene was renamed."""
        return self.name.rpartition("-")[0] if self.renamed else self.name

    @property
    def notice(self) -> str | None:
        """What people should know of its name before anything runs; None for nothing."""
        if not self.renamed:
            return None
        if self.gone is None:
            return f"another capture already has this name in the workspace, so the scene is called {self.name} (see --name)"
        return (
            f"a capture that is not there any more, {self.gone}, has this name, so the scene is called {self.name}; "
            f"--name {self.own_name} takes it over"
        )

    def claim(self) -> Scene:
        """Takes the folder for the capture, and returns the scene. It has another name if another capture has meanwhile taken this one. A
        chosen name is also taken over from a capture that is not there any more.

        Raises NameTakenError if the name was chosen, or the other name is taken, too; StageError if the file system has no locks.
        """
        if _owner(self.folder) == str(self.capture) and not _only_claimed(self.folder):
            return self
        with _alone(self.folder.parent.parent):
            scene = self
            if (owner := _owner(self.folder)) not in (None, str(self.capture)):
                if not (self.chosen or self.renamed):
                    scene = _other_name(self)
                    owner = _owner(scene.folder)
                if owner not in (None, str(self.capture)) and not (self.chosen and _is_gone(owner)):
                    raise NameTakenError(scene.name, str(owner), scene.folder)
            # Of a claim without results, too: the other process that has made it then sees that it is shared, and leaves it there.
            file = scene.folder / CLAIM
            write_json(file, {"path": str(self.capture)})
            return replace(scene, made=_identity(file) if owner is None else None, gone=None if scene.chosen else scene.gone)

    def restore(self) -> None:
        """Writes the claim again if somebody has removed the folder since."""
        if not (self.folder / CLAIM).exists():
            write_json(self.folder / CLAIM, {"path": str(self.capture)})

    def release(self) -> None:
        """Gives the folder up if `claim` has created it, it is still empty, and no other process has claimed it for the same capture."""
        if self.made is None:
            return
        with suppress(OSError), _alone(self.folder.parent.parent):
            if _only_claimed(self.folder) and _identity(self.folder / CLAIM) == self.made:
                (self.folder / CLAIM).unlink()
                self.folder.rmdir()
                self.folder.parent.rmdir()  # if it is empty


def check_name(name: str, where: str) -> None:
    """Raises SettingsError, which begins with ``where``, for what is no name of a scene or a batch."""
    if not is_safe(name):
        raise SettingsError(f"{where}: {RULE}")


def find_scene(workspace: Path, capture: Path, own_name: str, chosen: str | None) -> Scene:
    """The scene of a capture (an absolute path): ``chosen``, or the capture's own name made safe for a folder.

    Two captures of the same name never share a folder. Without ``chosen``, the second is called ``name-<6 hex digits of its path>``, also
    if the first is not there: its disk may come back. Raises NameTakenError if ``chosen`` belongs to another capture that is there,
    SettingsError if it is no name. Until `Scene.claim`, another process may still take the folder.
    """
    scenes = workspace / "scenes"
    if chosen is not None:
        check_name(chosen, f"--name {chosen}")
        owner = _owner(scenes / chosen)
        if owner in (None, str(capture)):
            return Scene(chosen, scenes / chosen, capture, chosen=True)
        if not _is_gone(owner):
            raise NameTakenError(chosen, str(owner), scenes / chosen)
        return Scene(chosen, scenes / chosen, capture, chosen=True, gone=owner)
    name = safe_name(own_name) or "capture"
    scene = Scene(name, scenes / name, capture)
    return scene if _owner(scene.folder) in (None, str(capture)) else _other_name(scene)


def _other_name(scene: Scene) -> Scene:
    name = f"{scene.name}-{digest_bytes(str(scene.capture).encode())[:6]}"
    owner = _owner(scene.folder)
    return replace(scene, name=name, folder=scene.folder.parent / name, renamed=True, gone=owner if _is_gone(owner) else None)


def owner_of(folder: Path) -> str | None:
    """Path of the capture that a scene's folder names as its own; None if it is no scene's folder."""
    claim = read_json(folder / CLAIM)
    return claim["path"] if isinstance(claim, dict) and isinstance(claim.get("path"), str) else None


def scenes_in(workspace: Path) -> list[Path]:
    """Folders of all scenes of a workspace, by name."""
    return [claim.parent for claim in sorted((workspace / "scenes").glob(f"*/{CLAIM}"))]


def scenes_of(capture: Path, workspace: Path) -> list[Path]:
    """Those that were made from this capture."""
    path = str(Path(os.path.abspath(capture.expanduser())).resolve())
    return [folder for folder in scenes_in(workspace) if owner_of(folder) == path]


def _owner(folder: Path) -> str | None:
    """As `owner_of`, but None only for a folder that is free."""
    owner = owner_of(folder)
    return "an unknown capture" if owner is None and _content(folder) else owner


def _is_gone(owner: str | None) -> bool:
    """Whether there is nothing at the path of a capture any more, because it was moved, renamed or removed."""
    if owner is None or not os.path.isabs(owner):
        return False
    try:
        os.stat(owner)
    except (FileNotFoundError, NotADirectoryError):
        return True
    except OSError:  # no permission, or a disk that does not answer
        pass
    return False


def _only_claimed(folder: Path) -> bool:
    """Whether there is nothing in a claimed folder but the claim: no stage has finished."""
    return _content(folder) == {CLAIM}


def _content(folder: Path) -> set[str]:
    """Names in ``folder``, without claims that are being written; empty if there is no such folder."""
    try:
        return {path.name for path in folder.iterdir() if not path.name.startswith(f".{CLAIM}.")}
    except (FileNotFoundError, NotADirectoryError):
        return set()


def _identity(file: Path) -> tuple[int, int]:
    found = file.stat()
    return found.st_ino, found.st_mtime_ns


@contextmanager
def _alone(workspace: Path) -> Iterator[None]:
    """Only one process at a time takes or gives up a scene's folder."""
    with locked(workspace / "store" / "locks" / "scenes.lock"):
        yield
