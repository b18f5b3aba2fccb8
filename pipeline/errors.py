"""The errors that reach a user; each message names the file, frame or field and says what to do next."""


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
    """An artifact is missing, cut short or damaged: exit code 1."""
