"""Finds results in a workspace's store by what a person types: a key, the beginning of a key, or a scene and a stage."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...pipeline import ArtifactError, Records, SettingsError, Store
from ...pipeline.files import bytes_in, read_json
from ...pipeline.names import composed
from ..results import in_workspace
from ..which_scene import scene_of

SHORTEST = 4  # digits of a key that are enough if they identify a single result


def opened(workspace: Path) -> Store:
    """The store of a workspace as it was typed. Raises SettingsError if there is none: an empty answer would hide a mistyped path."""
    store = Store(workspace.resolve() / "store")
    if not store.root.is_dir():
        raise SettingsError(f"--workspace {workspace}: there is no workspace here (no store/ in it); give the folder that a run wrote to")
    return store


@dataclass(frozen=True)
class Stored:
    """One result. path: its folder. scenes: the scenes whose last run used it."""

    stage: str
    key: str
    path: Path
    manifest: Mapping[str, Any]
    scenes: tuple[str, ...]

    @property
    def name(self) -> str:
        return f"{self.stage}/{self.key}"

    @property
    def size(self) -> int:
        """Bytes on the disk, as `gc` counts them: those of the manifest, too."""
        return bytes_in(self.path)

    def made(self, field: str, unknown: Any = None) -> Any:
        """A field of the provenance, or ``unknown``: results of other versions may not have it."""
        return self.manifest["provenance"].get(field, unknown)

    def arrays(self) -> list[tuple[str, str, str, str]]:
        """Name, shape, dtype and unit of each array, read without zarr."""
        found = []
        for file in sorted(file for file in self.manifest["files"] if file.endswith("/zarr.json")):
            described = read_json(self.path / file)
            if not isinstance(described, dict) or "shape" not in described:
                continue
            name = file.removesuffix("/zarr.json")
            shape = "x".join(map(str, described["shape"])) or "scalar"
            found.append((name, shape, str(described.get("data_type")), str(described.get("attributes", {}).get("unit", ""))))
        return found


def users(workspace: Path) -> dict[tuple[str, str], tuple[str, ...]]:
    """(stage, key) of every result that some scene's last run used -> the scenes' names."""
    found: dict[tuple[str, str], tuple[str, ...]] = {}
    for folder in sorted((workspace / "scenes").glob("*/records")):
        for path in folder.glob("*.json"):
            if (record := Records(folder).read(path.stem)) is not None:
                where = path.stem, record["key"]
                found[where] = (*found.get(where, ()), folder.parent.name)
    return found


def every(workspace: Path) -> list[Stored]:
    """All results with a valid manifest, by stage; `e4dgs store verify` says what is wrong with the others."""
    store, used = Store(workspace / "store"), users(workspace)
    found = []
    for stage, key in store.entries():
        if (manifest := store.manifest(stage, key)) is not None:
            found.append(Stored(stage, key, store.path(stage, key), manifest, used.get((stage, key), ())))
    return found


def find(workspace: Path, *words: str) -> Stored:
    """The result that the words name: KEY or STAGE/KEY, where the first digits are enough, or SCENE STAGE or SCENE/STAGE. SCENE may also be
    the scene's folder, or a capture: then its scene that ran last.

    Raises SettingsError if they name none or several, ArtifactError if the named result is not in the store or is damaged.
    """
    store, used = Store(workspace / "store"), users(workspace)
    first, last = _scene_and_stage(workspace, words)
    of_scene = {stage: (stage, key) for (stage, key), scenes in used.items() if first in scenes}
    matches = [of_scene[last]] if last in of_scene else []
    if not matches:
        matches = [(stage, key) for stage, key in store.entries() if first in ("", stage) and key.startswith(last)]
    if not matches and of_scene:
        raise SettingsError(f"{first}: no run of this scene has used a result of {last!r}; it has {', '.join(sorted(of_scene))}")
    if not matches or (len(last) < SHORTEST and last not in of_scene):
        raise SettingsError(
            f"{' '.join(words)}: this names no result in {workspace}; give a key ({SHORTEST} digits or more), STAGE/KEY, or a scene and "
            f"a stage (e4dgs store list{in_workspace(workspace)} has them all)"
        )
    if len(matches) > 1:
        raise SettingsError(f"{' '.join(words)}: several results begin so: {', '.join('/'.join(match) for match in matches[:5])}")
    stage, key = matches[0]
    if (manifest := store.manifest(stage, key)) is None:
        store.open(stage, key)  # raises an error that says what is wrong
        raise ArtifactError(f"{store.path(stage, key)}: cannot be read; run the stage again")
    return Stored(stage, key, store.path(stage, key), manifest, used.get((stage, key), ()))


def _scene_and_stage(workspace: Path, words: Sequence[str]) -> tuple[str, str]:
    """The scene or stage, and the stage or key, that the words of `find` name."""
    if len(words) > 1 and (scene := scene_of(Path(words[0]), workspace, words[1])) is not None:
        return scene, words[1]
    first, _, last = composed(" ".join(words)).replace(" ", "/").rpartition("/")
    return first, last
