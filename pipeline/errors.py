"""The errors that reach a user; each message names the file, frame or field and says what to do next."""

import unicodedata
from pathlib import Path

_DIRECTIONS = frozenset("\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069")
LONGEST = 1000  # characters of a message that quotes files which nobody has read


def one_line(text: str) -> str:
    """``text`` with line breaks, control characters and broken Unicode written as escapes, and its middle left out where it is long.

    A name in a capture could otherwise break the line, or move a terminal's cursor.
    """
    if len(text) > LONGEST:
        text = f"{text[: LONGEST - 300]} ... {text[-295:]}"
    return "".join(c.encode("unicode_escape", "surrogatepass").decode("ascii") if is_odd(c) else c for c in text)


def is_odd(character: str) -> bool:
    """A control character, a line separator, half of a surrogate pair, or what turns the direction of writing: no plain text. Joiners and
    spaces of all kinds, which names of files do have, are."""
    return unicodedata.category(character) in ("Cc", "Cs", "Zl", "Zp") or character in _DIRECTIONS


class PipelineError(Exception):
    """Base of every error that is shown as one message, without a traceback."""

    exit_code = 1


class StageError(PipelineError):
    """A stage failed: exit code 1."""


class CaptureError(PipelineError):
    """The capture cannot be used as it is: exit code 2. Its message is one line of printable text, whatever the capture's names hold."""

    exit_code = 2

    def __init__(self, message: str) -> None:
        super().__init__(one_line(message))


class SettingsError(PipelineError):
    """A setting, a stage name or another argument is wrong: exit code 2."""

    exit_code = 2


class ArtifactError(PipelineError):
    """An artifact is missing, cannot be read, or is damaged: exit code 1."""


class DamagedError(ArtifactError):
    """An artifact is not as it was written. ``problem`` names the file and says what is wrong; the message adds what to do."""

    def __init__(self, path: Path, file: str, what: str, advice: str = "run the stage again") -> None:
        super().__init__(f"{path / file}: {what}; {advice}")
        self.file, self.what, self.problem = file, what, f"{path / file}: {what}"
