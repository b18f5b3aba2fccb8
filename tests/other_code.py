"""Keys as after an edit of the source that a stage reaches."""

from typing import Any

import pytest
from e4dgs.pipeline import Stage
from e4dgs.pipeline.code.reach import code_of


def edit(monkeypatch: pytest.MonkeyPatch, edited: type[Stage], file: str) -> None:
    """From now on a file that a stage reaches has another content."""

    def other(stage: type[Stage], cuda: bool = False) -> dict[str, Any]:
        found = code_of(stage, cuda)
        if stage is not edited:
            return found
        assert file in found["files"]
        return {"digest": "another", "files": {**found["files"], file: "another"}}

    monkeypatch.setattr("e4dgs.pipeline.keys.code_of", other)
