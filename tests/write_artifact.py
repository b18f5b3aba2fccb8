"""Artifacts made by hand, for stages to read."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from e4dgs.pipeline import Artifact, ArtifactWriter


def write_artifact(folder: Path, arrays: Mapping[str, np.ndarray], **attrs) -> Artifact:
    """What a stage would have left in the new `folder` if these were its arrays and attributes."""
    folder.mkdir(parents=True)
    out = ArtifactWriter(folder)
    for name, values in arrays.items():
        out.write(name, values)
    out.attrs.update(attrs)
    out.finish({})
    return Artifact(folder)
