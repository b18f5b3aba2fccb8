"""The base class of stages, and what a stage is given when it runs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

from .machine.resources import Resources
from .settings import Settings

if TYPE_CHECKING:
    from .reusable import Earlier
    from .running.progress import Progress
    from .storage.artifact import Artifact
    from .storage.writer import ArtifactWriter


class Capture(Protocol):
    """The input files of a run. ``facts`` come from file names and headers only. ``files`` are relative to ``root``."""

    @property
    def root(self) -> Path: ...
    @property
    def name(self) -> str: ...
    @property
    def files(self) -> Sequence[str | Path]: ...
    @property
    def facts(self) -> Mapping[str, Any]: ...


@dataclass(frozen=True)
class Applies:
    """Whether a stage has anything to do for a capture, and why."""

    needed: bool
    reason: str

    @classmethod
    def yes(cls, reason: str = "") -> Applies:
        return cls(True, reason)

    @classmethod
    def no(cls, reason: str) -> Applies:
        return cls(False, reason)


@dataclass(frozen=True)
class Given:
    """What a result is made from. ``digests`` maps the relative name of each of the capture's files to the digest of its content; it is
    empty for a stage that does not read the capture."""

    capture: Capture
    facts: Mapping[str, Any]
    settings: Any  # the stage's own Settings instance
    inputs: Mapping[str, Artifact | None]
    digests: Mapping[str, str]


class Stage:
    """One step of a workflow: reads artifacts and writes one artifact. Subclasses set the class attributes and implement ``run``.

    The key covers the source that `run` reaches through import statements. Modules imported under a computed name are not detected.
    A stage must produce the same arrays and attrs for the same key; values that vary from run to run (timings) go to ``ctx.out.info``.
    """

    name: ClassVar[str]  # CLI name and settings prefix
    inputs: ClassVar[tuple[str, ...]] = ()  # names of stages; the artifact of a skipped stage is None
    settings: ClassVar[type[Settings]] = Settings
    reads_capture: ClassVar[bool] = False  # if True, the key includes the content digest of the capture
    device_class: ClassVar[bool] = False  # if True, results differ between cpu and cuda, and the key includes the device
    items: ClassVar[str] = ""  # what a result consists of ("pairs"), if items of an earlier result may be reused

    def applies(self, facts: Mapping[str, Any], settings: Any) -> Applies:
        """Whether the stage has anything to do. Must be quick and import nothing heavy."""
        return Applies.yes()

    def estimate(self, facts: Mapping[str, Any], settings: Any) -> float | None:
        """Expected wall time in seconds, or None if it has not been measured. If items of an earlier result are reused,
        ``facts["new_items"]`` is the number of items left to compute."""
        return None

    def item_parts(self, given: Given) -> Sequence[Any]:
        """For each item, in order, everything that determines it other than code, settings and device class, as JSON. Must be quick, like
        `applies`, because a plan calls it as soon as the inputs are known."""
        return ()

    def resources(self, facts: Mapping[str, Any], settings: Any, device: str) -> Resources:
        """The resources the stage uses while it runs on ``device``. Must be quick and import nothing heavy."""
        return Resources(gpu=self.device_class and device == "cuda")

    def run(self, ctx: Context) -> None:
        """Writes the artifact into ``ctx.out``. Raises StageError or CaptureError with a message for the user."""
        raise NotImplementedError


@dataclass
class Context:
    """Everything that a running stage may use."""

    capture: Capture
    facts: Mapping[str, Any]
    settings: Any  # the stage's own Settings instance
    inputs: Mapping[str, Artifact | None]
    out: ArtifactWriter
    checkpoints: Path  # folder for this key only; survives a kill and is removed once the result is published
    device: str  # "cpu" | "cuda"
    log: Callable[[str], None]  # one line for the user and the report
    progress: Callable[[int, str], Progress]  # progress(total, label)
    earlier: Earlier | None = None  # an earlier result that already has some of the items; every byte of it has been verified
    lends: bool = True  # a stage sets this to False if its result has no reusable items after all
