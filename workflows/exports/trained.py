"""What every export of a trained model needs: the model and frames of a capture from the store, and where the files go."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ...pipeline import CaptureError, SettingsError, StageError, say
from ...scene.formats.axes import AXES, Turn
from ...stages.exports.numbered import strangers
from ...stages.facts import Facts
from ..machine.places import FOLDERS, is_folder, typed_output
from ..results import results, trained_stage
from ..session import Options, Session, open_session

if TYPE_CHECKING:
    from ...scene.model import Model
    from ...stages.shared.posed_frameset import PosedFrameSet

MOST_TIMES, MOST_ASKED = 60, 10_000  # by default, and that --times takes


def out_option(metavar: str, help: str) -> Any:
    return typer.Option("--out", parser=typed_output, metavar=metavar, help=help)


def times_option(help: str) -> Any:
    return typer.Option("--times", min=1, max=MOST_ASKED, help=help)


Moment = Annotated[float | None, typer.Option("--time", metavar="T", help="Only this time, 0 (first) to 1 (last).")]
Up = Annotated[
    str | None,
    typer.Option("--up", metavar="AXIS", help="Axis of the file that points up: X, -X, Y, -Y, Z, -Z, or capture for the capture's axes."),
]
Antialiased = Annotated[
    bool, typer.Option("--antialiased", help="The Gaussians as trained, for viewers in the antialiased mode, such as Spark.")
]


@dataclass
class Trained:
    """A trained model, the frames that it was trained on, and the session that found both."""

    session: Session
    model: Model
    frames: PosedFrameSet

    @property
    def times(self) -> int:
        """Number of times of the capture; 1 if nothing moves."""
        return 1 if self.model.motion.static else Facts.of(self.session.job.capture.facts).times

    def moments(self, asked: int | None) -> int:
        """How many times are exported: ``asked``, or all of the capture's but at most `MOST_TIMES`; one if nothing moves, and a line says
        so if more were asked for."""
        if self.model.motion.static and asked is not None and asked > 1:
            say(f"nothing moves in this scene, so --times {asked} makes one file")
        return 1 if self.model.motion.static else asked or min(self.times, MOST_TIMES)

    def chosen(self, count: int | None, time: float | None) -> list[float]:
        """The moments in [0, 1] that are exported: ``time`` alone, or `moments` of them from first to last; one of them is the middle."""
        number = 1 if time is not None else self.moments(count)
        if number == 1:
            return [0.5 if time is None else time]
        return [k / (number - 1) for k in range(number)]

    def thinned(self, number: int, asked: int | None) -> tuple[str, ...]:
        """The line that tells that an export has a ``number`` of times and the capture more, though nobody ``asked`` for that; or none."""
        if asked is not None or not MOST_TIMES <= number < self.times:
            return ()
        most = min(self.times, MOST_ASKED)
        wanted = f"--times {most} for {'all' if most == self.times else 'more'}"
        return (f"note: {number} of {self.times} times; {wanted}; what is visible only between them is left out",)


def open_trained(options: Options) -> Trained:
    """Finds the trained model. Raises CaptureError or ArtifactError if there is none with these options."""
    session = open_session(options)
    trained = trained_stage(session)
    found = results(session, trained)
    artifact, frames = found[trained], found["frames"]
    assert artifact is not None and frames is not None  # `results` guarantees the first, and no stage runs without the second

    from ...stages.shared.model import read_model
    from ...stages.shared.posed_frameset import PosedFrameSet

    return Trained(session, read_model(artifact), PosedFrameSet(frames, session.job.capture.root, found.get("poses")))


def check_posed(options: Options, frames: PosedFrameSet, lacking: str = "is no place to look from") -> None:
    """Raises CaptureError if no training frame has a pose. lacking: what there then is not."""
    if not len(frames.train):
        raise CaptureError(f"{options.capture}: no training frame has a pose, so there {lacking}")


def axes_line(turn: Turn, frames: PosedFrameSet) -> str:
    """How the files of an export lie in the world of the capture's files, for people."""
    if frames.origin is None:
        return f"axes: {turn}"
    return f"axes: {turn}; 0 0 0 is the point ({', '.join(f'{x:.9g}' for x in frames.origin)}) of the capture's files"


def check_folder(out: Path | None) -> None:
    """Raises SettingsError if ``out`` is a file."""
    if out is not None and out.exists() and not out.is_dir():
        raise SettingsError(f"--out {out}: this is a file; name a folder")


def check_moment(time: float | None, times: int | None) -> None:
    """Raises SettingsError if ``time`` is not in [0, 1] or if both are given."""
    if time is not None and times is not None:
        raise SettingsError("--time and --times: give one of them")
    if time is not None and not 0 <= time <= 1:
        raise SettingsError(f"--time {time:g}: give a number from 0 (first time of the capture) to 1 (last)")


def up_axis(up: str | None) -> str | None:
    """``up`` as one of `AXES` or "capture"; None if it was not given. Raises SettingsError for anything else."""
    if up is None:
        return None
    axis = up.strip().removeprefix("+")
    axis = axis.lower() if axis.lower() == "capture" else axis.upper()
    if axis not in (*AXES, "capture"):
        raise SettingsError(f"--up {up}: give one of {', '.join(AXES)}, or capture for the axes of the capture")
    return axis


def check_single(out: Path, moments: int, ending: str) -> None:
    """Raises SettingsError if the file ``out`` would have to hold several ``moments``."""
    if moments > 1:
        raise SettingsError(f"--out {out}: a {ending} file holds one time, and here are {moments}; add --time 0.5, or name a folder")


def check_strangers(out: Path | None, ending: str) -> None:
    """Raises SettingsError if ``out`` is a folder with numbered files of somebody else, among which ours could not be told apart."""
    others = [] if out is None else strangers(out, ending)
    if others:
        more = f" and {len(others) - 1} more" if len(others) > 1 else ""
        raise SettingsError(
            f"--out {out}: it has {others[0]}{more}, which no earlier export has listed there; a reader would play them as one sequence; "
            "name another folder, or move these away"
        )


def is_file(out: Path | None, endings: tuple[str, ...]) -> bool:
    """Whether ``out`` names a file with one of ``endings``, and no folder (`is_folder`). Raises SettingsError for other endings."""
    if out is None or is_folder(out):
        check_folder(out)
        return False
    if out.suffix.lower() not in endings:
        raise SettingsError(f"--out {out}: the file must end in {' or '.join(endings)}; {FOLDERS}")
    return True


@contextmanager
def writing(out: Path, what: str = "export") -> Iterator[None]:
    """Turns errors of writing to disk into a StageError that names the file. what: the command."""
    try:
        yield
    except OSError as error:
        raise StageError(f"{what}: {error.filename or out} cannot be written ({error.strerror or error}); give another --out") from error
