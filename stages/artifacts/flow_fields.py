"""Reading a `flow` artifact pair by pair, for people who look at it; training reads it through `dataset.py`."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np

from ...pipeline import Artifact, ArtifactError

Result = TypeVar("Result")


class FlowFields:
    """Pairs of a `flow` artifact (docs/artifacts.md). ``pairs`` [P, 2]: frames. Arrays are read a pair at a time, from any thread.

    Raises ArtifactError where an array is missing or damaged.
    """

    def __init__(self, flow: Artifact) -> None:
        self._flow = flow
        self.pairs: list[tuple[int, int]] = [(int(a), int(b)) for a, b in flow.read("pair")]
        cameras = flow.attrs.get("moving_cameras", []) if "moving" in flow else []
        self._mask_of = {int(camera): k for k, camera in enumerate(cameras)}

    def forward(self, p: int) -> np.ndarray:
        """Measured flow of pair ``p``, float16 [H, W, 2] px."""
        return self._read("forward", p)

    def backward(self, p: int) -> np.ndarray:
        """Flow from the second frame of pair ``p`` to its first, float16 [H, W, 2] px, seen from the second."""
        return self._read("backward", p)

    def confidence(self, p: int) -> np.ndarray:
        """uint8 [H, W], 255 where both directions of pair ``p`` agree."""
        return self._read("confidence", p)

    def edges(self, frame: int) -> np.ndarray:
        """Edge weight of a training frame, uint8 [H, W]."""
        return self._read("edges", frame)

    def moving(self, frame: int, camera: int) -> np.ndarray | None:
        """What moves in a training frame of a camera, uint8 [H, W]; where frames have no masks, what ever changes before a fixed camera,
        None before others."""
        if "movers" in self._flow:
            return self._read("movers", frame)
        return self._read("moving", self._mask_of[camera]) if camera in self._mask_of else None

    def _read(self, name: str, k: int) -> np.ndarray:
        array = self._flow.array(name)
        return checked(lambda: np.asarray(array[k]), f"{self._flow.path}: array {name!r}, row {k}")


def checked(read: Callable[[], Result], what: str) -> Result:
    """``read()``; a chunk that is damaged raises ArtifactError that says ``what`` and what to do."""
    try:
        return read()
    except (ValueError, RuntimeError, OSError) as error:
        raise ArtifactError(f"{what} is damaged ({error}); make it again with `e4dgs run flow CAPTURE --force`") from error
