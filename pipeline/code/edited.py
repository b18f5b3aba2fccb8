"""Detects source files that were edited while a run was in progress."""

from ..errors import StageError
from ..records import changed_files
from ..stage import Stage
from .reach import code_now, code_of


def refuse_edited(stage: Stage, device: str) -> None:
    """Raises StageError if source that a stage reaches has changed since this process computed the stage's key. Part of the old source is
    already imported and the rest would be imported now, so the result would belong to neither version."""
    how = type(stage), stage.device_class and device == "cuda"
    if changed := changed_files(code_of(*how), code_now(*how)):
        raise StageError(f"{stage.name}: {'; '.join(changed)} since this run began; run it again: finished results are kept")
