"""The setting of `depth`."""

from __future__ import annotations

import os
from pathlib import Path

from pydantic import Field, field_validator

from ...pipeline import Settings
from ...vision.depth.names import is_name


class DepthSettings(Settings):
    model: Path | str | None = Field(
        None,
        description="network for depth of single frames, by transformers: its folder, or its name on huggingface.co, perhaps with "
        "@REVISION. none: depth maps of the capture, if it has any",
    )

    @field_validator("model")
    @classmethod
    def _folder_or_name(cls, value: Path | str | None) -> Path | str | None:
        """A folder enters the key with its content."""
        if value is None or os.path.isdir(value):
            return None if value is None else Path(value)
        if not is_name(str(value)):
            raise ValueError("there is no such folder, and a name on huggingface.co looks like OWNER/MODEL")
        return str(value)
