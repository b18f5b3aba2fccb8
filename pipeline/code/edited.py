"""A run whose source is edited while it goes on."""

from ..errors import StageError
from ..records import changed_files
from ..stage import Stage
from .reach import code_now, code_of


def refuse_edited(stage: Stage, device: str) -> None:
    """Raises StageError where source that a stage reaches has changed since this process made its key. Some of it has been imported before,
    the rest would be now, and the result would be that of neither."""
    how = type(stage), stage.device_class and device == "cuda"
    if changed := changed_files(code_of(*how), code_now(*how)):
        raise StageError(f"{stage.name}: {'; '.join(changed)} since this run began; run it again, what is done is kept")
