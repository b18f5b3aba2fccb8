"""Names of networks on huggingface.co."""

from __future__ import annotations

import re

_NAME = re.compile(r"\w[\w.-]*(/\w[\w.-]*)?(@[\w.-]+)?")  # OWNER/MODEL or MODEL, and perhaps a branch or a commit


def is_name(text: str) -> bool:
    """Whether ``text`` may be such a name, with or without @REVISION."""
    return _NAME.fullmatch(text) is not None
