"""Reads the `flow` artifact, one pair or frame at a time. `artifact_writer.py` writes it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from ...pipeline import Artifact, ArtifactError

if TYPE_CHECKING:
    import zarr

Result = TypeVar("Result")


@dataclass(frozen=True)
class StoredFlow:
    """Flow of P pairs of frames of H x W px, edge weights, and masks of moving pixels. Any thread may read.

    Raises ArtifactError if an array is missing or damaged.
    """

    artifact: Artifact

    @cached_property
    def pairs(self) -> list[tuple[int, int]]:
        """P pairs: a frame and the same camera's next frame."""
        return [(int(a), int(b)) for a, b in self.artifact.read("pair")]

    @property
    def static(self) -> bool:
        """The stage found that nothing moves: before it measured any flow, or because flow failed where something seemed to move."""
        return bool(self.artifact.attrs.get("static"))

    @property
    def static_reason(self) -> str | None:
        """Why the scene is `static` or why it is not, for people; None if this was not checked."""
        return self.artifact.attrs.get("static_reason")

    @property
    def method(self) -> str:
        """The method that measured the flow: "dis-medium", "raft", ...; "none" if there are no pairs, empty if no flow was wanted."""
        return str(self.artifact.attrs.get("method", ""))

    @property
    def working_size(self) -> int:
        """px, longest side of the pictures on which flow was measured. Only available if `measured`."""
        return self.artifact.attrs["working_size"]

    @property
    def measured(self) -> bool:
        """Whether there are flow arrays. They may have no rows."""
        return "forward" in self.artifact

    def forward(self, p: int) -> np.ndarray:
        """Measured flow of pair ``p``, float16 [H, W, 2] px: u to the right, v down."""
        return self._row("forward", p)

    def backward(self, p: int) -> np.ndarray:
        """Flow from the second frame of pair ``p`` to the first, float16 [H, W, 2] px, on the pixels of the second."""
        return self._row("backward", p)

    def between_lens_pictures(self, p: int) -> tuple[np.ndarray, np.ndarray]:
        """Forward and backward flow of pair ``p``, float16 [H, W, 2] px, between the distorted pictures."""
        prefix = "lens_" if "lens_forward" in self.artifact else ""
        return self.artifact.read(f"{prefix}forward", p), self.artifact.read(f"{prefix}backward", p)

    def confidence(self, p: int) -> np.ndarray:
        """uint8 [H, W], on the pixels of the first frame: 255 where both directions of pair ``p`` agree and the second frame shows the
        pixel."""
        return self._row("confidence", p)

    @property
    def has_edges(self) -> bool:
        return "edges" in self.artifact

    def edges(self, frame: int) -> np.ndarray:
        """Edge weights of a training frame, uint8 [H, W]; 0 for other frames."""
        return self._row("edges", frame)

    @property
    def has_moving(self) -> bool:
        """Whether each training frame has a mask of moving pixels."""
        return "moving" in self.artifact

    def moving(self, frame: int) -> np.ndarray:
        """uint8 [H, W], 255 where a training frame shows something that moves in the world; 0 for other frames."""
        return self._row("moving", frame)

    @property
    def size(self) -> tuple[int, int]:
        """(H, W) of the masks; requires `has_moving`."""
        height, width = self._array("moving").shape[1:]
        return height, width

    @property
    def has_ever_moving(self) -> bool:
        """Whether each fixed camera has a mask of all pixels that ever change."""
        return "ever_moving" in self.artifact

    @cached_property
    def ever_moving_cameras(self) -> list[int]:
        """Indices of the fixed cameras, in the order of their masks."""
        return [int(camera) for camera in self.artifact.attrs.get("ever_moving_cameras", [])] if self.has_ever_moving else []

    def ever_moving_masks(self) -> list[tuple[int, np.ndarray]]:
        """For each fixed camera its index and mask, uint8 [H, W], 255 = this pixel changes over time."""
        return list(zip(self.ever_moving_cameras, self.artifact.read("ever_moving"), strict=True))

    def moving_pixels(self, frame: int, camera: int) -> np.ndarray | None:
        """Moving pixels of a training frame of a camera, uint8 [H, W]. If frames have no masks: the pixels of a fixed camera that ever
        change, or None for a camera that moves."""
        if self.has_moving:
            return self.moving(frame)
        return self._row("ever_moving", self.ever_moving_cameras.index(camera)) if camera in self.ever_moving_cameras else None

    @cached_property
    def _opened(self) -> dict[str, zarr.Array]:
        return {}

    def _array(self, name: str) -> zarr.Array:
        if name not in self._opened:
            self._opened[name] = self.artifact.array(name)
        return self._opened[name]

    def _row(self, name: str, k: int) -> np.ndarray:
        array = self._array(name)
        return checked(lambda: np.asarray(array[k]), f"{self.artifact.path}: array {name!r}, row {k}")


def flow_of(inputs: Mapping[str, Artifact | None]) -> StoredFlow | None:
    """The flow among a stage's inputs; None if the stage `flow` was skipped."""
    artifact = inputs["flow"]
    return None if artifact is None else StoredFlow(artifact)


def checked(read: Callable[[], Result], what: str) -> Result:
    """``read()``. A damaged chunk raises ArtifactError, which names ``what`` is damaged and says what to do."""
    try:
        return read()
    except (ValueError, RuntimeError, OSError) as error:
        raise ArtifactError(f"{what} is damaged ({error}); make it again with `e4dgs run flow CAPTURE --force`") from error
