"""From command-line options to a job: settings, capture, scene, store."""

from __future__ import annotations

import os
import weakref
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ..pipeline import CaptureError, Job, SettingsError, Store, build_settings, say, settings_by_name, split_assignment
from .machine.devices import resolve_device
from .machine.writable import writing_to
from .presets import PRESETS
from .reconstruction import reconstruction
from .scenes import Scene, find_scene
from .storage.archive import InUse, unpacked

DEFAULT_WORKSPACE = Path("e4dgs-workspace")
SEEDS = ("poses.seed", "train.seed")  # settings that --seed sets


@dataclass(frozen=True)
class Choice:
    """The options that choose the results of a run."""

    preset: str = "default"
    set: tuple[str, ...] = ()
    device: str = "auto"
    static: bool = False
    format: str | None = None
    time: str | None = None  # how long the run may take, in the words of `timing.words`
    resolved: tuple[str, ...] = ()  # settings that were decided for that time, as for --set

    def words(self) -> list[str]:
        """As words of a command line, without those that have their default."""
        words = ["--preset", self.preset] if self.preset != "default" else []
        words += ["--device", self.device] if self.device != "auto" else []
        words += ["--format", self.format] if self.format is not None else []
        words += ["--static"] if self.static else []
        words += ["--time", self.time] if self.time and not self.resolved else []
        return words + [word for text in (*self.resolved, *self.set) for word in ("--set", text)]

    def assignments(self) -> list[tuple[str, Any]]:
        """Settings from the preset, then what --time decided, then --static and --format, then --set; later ones win. Raises
        SettingsError."""
        if self.preset not in PRESETS:
            raise SettingsError(f"--preset {self.preset}: there is no such preset; presets: {', '.join(PRESETS)}")
        chosen = [*PRESETS[self.preset].items(), *assigned(self.resolved)]
        chosen += [("frames.static", True)] if self.static else []
        chosen += [("frames.format", self.format)] if self.format is not None else []
        return chosen + assigned(self.set)


NO_CHOICE = Choice()


def assigned(texts: Sequence[str]) -> list[tuple[str, Any]]:
    """(stage.key, value) of each of ``--set``. Raises SettingsError."""
    return [(f"{stage}.{key}", value) for stage, key, value in map(split_assignment, texts)]


@dataclass
class Options:
    """What the user gave on the command line."""

    capture: Path
    workspace: Path = DEFAULT_WORKSPACE
    choice: Choice = NO_CHOICE
    name: str | None = None
    store_also: Sequence[Path] = ()  # other workspaces, or their stores
    last: bool = False  # these are the options of the last run: what that made is meant, also if the code has changed since


@dataclass
class Session:
    """A job and the scene that it writes to. notes: for people: older spellings of settings, and remarks of the capture's reader."""

    options: Options
    job: Job
    scene: Scene
    notes: tuple[str, ...] = ()

    def claim(self) -> None:
        """Takes the scene's folder for the capture (`Scene.claim`), and says so if it was that of a capture that is not there any more. If
        another capture has just taken it, the scene changes its name."""
        earlier = self.scene.gone if self.scene.chosen else None
        self.scene = self.scene.claim()
        if earlier is not None:
            say(f"the capture of scene {self.scene.name} was {earlier}, which is gone; it is now {self.scene.capture}")
        self.job.records = self.scene.records

    def export_folder(self, out: Path | None, kind: str) -> Path:
        """``out``, or the scene's folder for exports of this ``kind``."""
        if out is not None:
            return out
        with writing_to(self.options.workspace.resolve()):
            self.claim()
        return self.scene.folder / "export" / kind

    def resolve(self, values: Mapping[str, Any]) -> None:
        """Changes settings that were left to be decided, by their names. What has already run keeps its own."""
        others = [text for text in self.options.choice.resolved if text.partition("=")[0] not in values]
        decided = (*others, *(f"{name}={value}" for name, value in values.items()))
        self.options.choice = replace(self.options.choice, resolved=decided)
        classes = self.job.graph.settings
        built, names = build_settings(classes, self.options.choice.assignments()), settings_by_name(classes)
        changed = {stage for name in values for stage in names[name][0]}
        self.job.settings = {**self.job.settings, **{stage: built[stage] for stage in changed}}


def open_session(options: Options) -> Session:
    """Recognises the capture and sets up its job. Writes nothing except unpacked archives and sound onsets of long videos (`heard/`).
    Raises SettingsError, CaptureError, or StageError if an archive cannot be unpacked into the workspace."""
    from ..stages.frames.settings import FramesSettings, recognise_for

    graph = reconstruction()
    notes: list[str] = []
    settings = build_settings(graph.settings, options.choice.assignments(), notes.append)
    device = resolve_device(options.choice.device)
    frames = settings["frames"]
    assert isinstance(frames, FramesSettings)
    workspace = options.workspace.resolve()
    given, user = options.capture.expanduser(), InUse()
    with writing_to(workspace):
        content = unpacked(given, workspace, user)
    try:
        capture = recognise_for(content, frames, workspace / "heard", device)
    except CaptureError as error:
        if content == given:
            raise
        raise CaptureError(f"{given.name}: {error}") from error
    # What the device decided stands in the settings, so that keys contain it.
    settings = {**settings, "frames": frames.model_copy(update=dict(capture.chosen))}
    weakref.finalize(capture, id, user)  # an archive's files are in use as long as the capture is
    path = Path(os.path.abspath(options.capture.expanduser())).resolve()
    scene = find_scene(workspace, path, capture.name, options.name)
    store = Store(workspace / "store")
    also = [Store(path) for path in other_stores(options.store_also) if path != store.root]
    job = Job(graph, capture, settings, store, scene.records, device, also)
    return Session(options, job, scene, (*notes, *capture.notes))


def other_stores(paths: Sequence[Path]) -> list[Path]:
    """The stores of --store-also. Raises SettingsError for a path that is not a folder."""
    found = []
    for path in paths:
        place = path.expanduser().resolve()
        if not place.is_dir():
            raise SettingsError(f"--store-also {path}: there is no such folder; name a workspace, or the store in it")
        found.append(place / "store" if (place / "store").is_dir() else place)
    return found
