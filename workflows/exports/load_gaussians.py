"""`e4dgs.load_gaussians`: the model of a finished run as Gaussians only, as exports have it, for a script."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ..session import DEFAULT_WORKSPACE
from ..which_scene import Given, options_of_last_run
from .trained import open_trained

if TYPE_CHECKING:
    from ...stages.exports.bake import Baked


def load_gaussians(path: str | Path, workspace: str | Path = DEFAULT_WORKSPACE, classic: bool = False) -> Baked:
    """The last run of a scene, with a Gaussian in place of each convex. ``.at(t)`` of the result gives the `Gaussians` at time ``t`` in
    [0, 1], on the CPU, in the axes of the capture: what `e4dgs export` writes, before it turns them.

    Args:
        path, workspace: as for `e4dgs.load`.
        classic: for renderers in the classic mode, as exports are without --antialiased: opacities and sizes are adjusted to those, at the
            size and distance of the training views. Otherwise the Gaussians stay as they were trained.

    Raises ArtifactError if there is no finished model.
    """
    trained = open_trained(options_of_last_run(Given(Path(path).expanduser(), Path(workspace).expanduser()), "coarse"))

    from ...stages.exports.bake import bake

    return bake(trained.model, trained.frames, antialiased=trained.model.antialiased and not classic)
