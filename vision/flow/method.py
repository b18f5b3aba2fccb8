"""One interface to all methods of optical flow: each picture is prepared once, and any two prepared pictures give a flow."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from ...pipeline import StageError
from ..images.pictures import shrunk

if TYPE_CHECKING:
    from .raft import Raft

Name = Literal["raft", "raft-small", "dis"]
Preset = Literal["ultrafast", "fast", "medium"]
MINIMUM_SIDE = 64  # px; DIS reads outside its buffers on thin pictures (found at sides below 32), so smaller ones are padded


class Prepared(NamedTuple):
    """``picture``, uint8 [H, W, 3] of ``size`` (height, width) px, and ``data``: the same picture in the form that one method needs."""

    size: tuple[int, int]
    data: Any
    picture: np.ndarray


class FlowMethod:
    """A method that measures flow. ``name`` is for display. Pictures whose longest side exceeds ``max_size`` are first scaled down by
    area averaging, and their flow is scaled up again. Threads may share a method; the flow does not depend on the number of threads."""

    name: str

    def __init__(self, max_size: int | None = None) -> None:
        self.max_size = max_size

    def prepare(self, picture: np.ndarray) -> Prepared:
        """``picture``: uint8 [H, W, 3] RGB. Raises ValueError for other shapes or dtypes."""
        if picture.ndim != 3 or picture.shape[2] != 3 or picture.dtype != np.uint8 or picture.size == 0:
            raise ValueError(f"picture: expected uint8 [H, W, 3] with H, W > 0, got {picture.dtype} {list(picture.shape)}")
        height, width = picture.shape[:2]
        return Prepared((height, width), self._prepare(shrunk(picture, self.max_size)), picture)

    def flow(self, first: Prepared, second: Prepared) -> np.ndarray:
        """Flow [H, W, 2] float32 px: pixel (x, y) of first is at (x+u, y+v) in second. Raises ValueError where their sizes differ."""
        import cv2

        if first.size != second.size:
            raise ValueError(f"first {list(first.size)} and second {list(second.size)} differ in size")
        flow = self._flow(first.data, second.data)
        height, width = first.size
        if flow.shape[:2] != first.size:
            scale = np.array([width / flow.shape[1], height / flow.shape[0]], np.float32)
            flow = cv2.resize(flow, (width, height), interpolation=cv2.INTER_LINEAR) * scale
        return np.ascontiguousarray(flow, np.float32)

    @contextmanager
    def side_by_side(self) -> Iterator[Callable[[], None]]:
        """Context in which several Python threads measure at once. Yields a function that each thread must call first."""
        yield lambda: None

    def _prepare(self, picture: np.ndarray) -> Any:
        raise NotImplementedError

    def _flow(self, first: Any, second: Any) -> np.ndarray:
        raise NotImplementedError


class Dis(FlowMethod):
    """Dense inverse search, Kroeger et al. 2016, by OpenCV."""

    def __init__(self, preset: Preset = "medium", max_size: int | None = None) -> None:
        super().__init__(max_size)
        self.preset, self.name = preset, f"dis-{preset}"

    def _prepare(self, picture: np.ndarray) -> Any:
        import cv2

        return cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)

    def _flow(self, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        import cv2

        presets = {
            "ultrafast": cv2.DISOPTICAL_FLOW_PRESET_ULTRAFAST,
            "fast": cv2.DISOPTICAL_FLOW_PRESET_FAST,
            "medium": cv2.DISOPTICAL_FLOW_PRESET_MEDIUM,
        }
        height, width = first.shape
        below, right = max(0, MINIMUM_SIDE - height), max(0, MINIMUM_SIDE - width)
        greys = [cv2.copyMakeBorder(grey, 0, below, 0, right, cv2.BORDER_REPLICATE) for grey in (first, second)]
        flow = cv2.DISOpticalFlow.create(presets[self.preset]).calc(greys[0], greys[1], None)  # type: ignore[call-overload]
        return flow[:height, :width]


class RaftFlow(FlowMethod):
    """RAFT with the weights of `network`. iterations, tolerance: see `raft.Raft.match`."""

    def __init__(self, network: Raft, iterations: int = 20, tolerance: float = 0.0, max_size: int | None = None) -> None:
        super().__init__(max_size)
        self.network, self.iterations, self.tolerance = network, iterations, tolerance
        self.name = network.architecture.name

    def _prepare(self, picture: np.ndarray) -> Any:
        return self.network.encode(picture)

    def _flow(self, first: Any, second: Any) -> np.ndarray:
        return self.network.match(first, second, self.iterations, self.tolerance)[0]

    @contextmanager
    def side_by_side(self) -> Iterator[Callable[[], None]]:
        import torch

        threads = torch.get_num_threads()
        try:
            yield lambda: torch.set_num_threads(1)  # OpenMP's thread count is per thread, MKL's is global
        finally:
            torch.set_num_threads(threads)


def choice(method: Name | None, weights: Path | None) -> tuple[str, str]:
    """The method that will run, "dis" or "raft", and why, in words for the plan. Loads nothing."""
    if method == "dis":
        return "dis", "OpenCV's DIS (flow.method)"
    if method is None and weights is None:
        return "dis", "OpenCV's DIS: RAFT, which is more accurate, needs weights (--set flow.weights=FILE)"
    where = f"weights of {weights.name}" if weights is not None else "torchvision's weights"
    return "raft", f"{method or 'RAFT'}, {where}"


def open_method(
    method: Name | None, weights: Path | None, preset: Preset, iterations: int, tolerance: float, device: str, max_size: int | None
) -> FlowMethod:
    """The method that the settings of `flow` choose, ready to measure. Raises StageError if its weights are missing or not RAFT's."""
    if choice(method, weights)[0] == "dis":
        return Dis(preset, max_size)
    return RaftFlow(open_raft(method, weights, device), iterations, tolerance, max_size)


def open_raft(method: Name | None, weights: Path | None, device: str) -> Raft:
    """The network that ``method`` and ``weights`` name; without a file, with torchvision's published weights. Raises StageError."""
    from .raft import Raft
    from .raft.weights import recognise

    half = device == "cuda"
    try:
        network = Raft.load(weights, device, half) if weights is not None else Raft(*recognise(_torchvisions(method)), device, half)
    except ValueError as error:
        raise StageError(f"flow.weights: {error}") from error
    if method not in (None, network.architecture.name):
        held = network.architecture.name
        raise StageError(f"flow.weights: {weights} holds {held}, but flow.method is {method}; leave flow.method out")
    return network


def _torchvisions(method: Name | None) -> dict[str, Any]:
    """The published weights. torchvision downloads them once, checks their hash, and keeps them in torch's cache."""
    advice = "give a file with --set flow.weights=FILE, or measure with --set flow.method=dis"
    try:
        from torchvision.models import optical_flow as published
    except Exception as error:  # not installed, or built for another torch
        raise StageError(
            f"flow.method={method} needs weights, and torchvision cannot be imported for its own ({error}); pip install 'e4dgs[raft]', "
            f"{advice}"
        ) from error
    chosen = published.Raft_Small_Weights if method == "raft-small" else published.Raft_Large_Weights
    try:
        return dict(chosen.DEFAULT.get_state_dict(progress=False, check_hash=True))
    except (OSError, RuntimeError) as error:
        raise StageError(f"flow.method={method}: torchvision's weights cannot be fetched ({error}); {advice}") from error
