"""The errors that reach a user; each message names the file, frame or field and says what to do next."""

from pathlib import Path


class PipelineError(Exception):
    """Base of every error that is shown as one message, without a traceback."""

    exit_code = 1


class StageError(PipelineError):
    """A stage failed: exit code 1."""


class CaptureError(PipelineError):
    """The capture cannot be used as it is: exit code 2."""

    exit_code = 2


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
