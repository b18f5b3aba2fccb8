"""The errors that users see. Each message names the file, frame or field and says what to do next."""

import unicodedata
from pathlib import Path

_DIRECTIONS = frozenset("\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069")
LONGEST = 1000  # characters of a message that may quote arbitrary text from a capture's files


def one_line(text: str) -> str:
    """``text`` with line breaks, control characters and invalid Unicode written as escapes. A long text is shortened in the middle.

    Otherwise a name in a capture could break the line or move the terminal's cursor.
    """
    if len(text) > LONGEST:
        text = f"{text[: LONGEST - 300]} ... {text[-295:]}"
    return "".join(c.encode("unicode_escape", "surrogatepass").decode("ascii") if is_odd(c) else c for c in text)


def is_odd(character: str) -> bool:
    """Whether a character is not plain text: a control character, a line separator, half of a surrogate pair, or one that changes the
    writing direction. Joiners and all kinds of spaces count as plain text, because file names do contain them."""
    return unicodedata.category(character) in ("Cc", "Cs", "Zl", "Zp") or character in _DIRECTIONS


class PipelineError(Exception):
    """Base class of all errors that are shown as one message, without a traceback."""

    exit_code = 1


class StageError(PipelineError):
    """A stage failed: exit code 1."""


class CaptureError(PipelineError):
    """The capture cannot be used as it is: exit code 2. The message is one line of printable text, whatever names the capture contains."""

    exit_code = 2

    def __init__(self, message: str) -> None:
        super().__init__(one_line(message))


class SettingsError(PipelineError):
    """A setting, a stage name or another argument is wrong: exit code 2."""

    exit_code = 2


class ArtifactError(PipelineError):
    """An artifact is missing, cannot be read, or is damaged: exit code 1."""


class DamagedError(ArtifactError):
    """An artifact differs from what was written. ``problem`` names the file and says what is wrong; the message adds what to do."""

    def __init__(self, path: Path, file: str, what: str, advice: str = "run the stage again") -> None:
        super().__init__(f"{path / file}: {what}; {advice}")
        self.file, self.what, self.problem = file, what, f"{path / file}: {what}"
