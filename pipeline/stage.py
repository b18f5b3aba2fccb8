"""What a stage is, and what it is given when it runs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

from .machine.resources import Resources
from .settings import Settings

if TYPE_CHECKING:
    from .earlier import Earlier
    from .running.progress import Progress
    from .storage.artifact import Artifact
    from .storage.writer import ArtifactWriter


class Capture(Protocol):
    """Input files of a run. ``facts`` are known from names and headers alone; ``files`` are relative to ``root``."""

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
    """What a result is made from. ``digests``: relative name of each file of the capture -> digest of its content; empty for a stage that
    does not read the capture."""

    capture: Capture
    facts: Mapping[str, Any]
    settings: Any  # the stage's own Settings instance
    inputs: Mapping[str, Artifact | None]
    digests: Mapping[str, str]


class Stage:
    """One step of a workflow: reads artifacts, writes one artifact. Subclasses set the class attributes and write ``run``.

    Its key holds the source that `run` reaches by import statements; what is imported under a computed name is not seen.
    A stage must give the same arrays and attrs for the same key; what varies from run to run (timings) goes to ``ctx.out.info``.
    """

    name: ClassVar[str]  # CLI name and settings prefix
    inputs: ClassVar[tuple[str, ...]] = ()  # names of stages; a skipped one arrives as None
    settings: ClassVar[type[Settings]] = Settings
    reads_capture: ClassVar[bool] = False  # the capture's content digest enters the key
    device_class: ClassVar[bool] = False  # results differ between cpu and cuda, the key says which
    items: ClassVar[str] = ""  # what a result consists of ("pairs"), where items of an earlier one may be taken over

    def applies(self, facts: Mapping[str, Any], settings: Any) -> Applies:
        """Whether there is anything to do; must be quick and import nothing heavy."""
        return Applies.yes()

    def estimate(self, facts: Mapping[str, Any], settings: Any) -> float | None:
        """Expected wall time in seconds, or None where nobody has measured it. ``facts["new_items"]`` is there where the others
        are taken over from an earlier result."""
        return None

    def item_parts(self, given: Given) -> Sequence[Any]:
        """For each item, in their order, all that decides it beside code, settings and device class, as JSON. Quick, like `applies`: a
        plan asks for it as soon as the inputs are known."""
        return ()

    def resources(self, facts: Mapping[str, Any], settings: Any, device: str) -> Resources:
        """What it takes while it runs on ``device``; must be quick and import nothing heavy."""
        return Resources(gpu=self.device_class and device == "cuda")

    def run(self, ctx: Context) -> None:
        """Writes the artifact into ``ctx.out``. Raises StageError or CaptureError with a message for the user."""
        raise NotImplementedError


@dataclass
class Context:
    """What a running stage may touch."""

    capture: Capture
    facts: Mapping[str, Any]
    settings: Any  # the stage's own Settings instance
    inputs: Mapping[str, Artifact | None]
    out: ArtifactWriter
    checkpoints: Path  # survives a kill, belongs to this key, emptied once the stage is published
    device: str  # "cpu" | "cuda"
    log: Callable[[str], None]  # one line for the user and the report
    progress: Callable[[int, str], Progress]  # progress(total, label)
    earlier: Earlier | None = None  # a result that has some of the items already; all of its bytes were read and found sound
    lends: bool = True  # a stage sets it to False where its result has no items after all
