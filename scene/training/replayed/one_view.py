"""What a CUDA graph of a training step reads besides the model: one frame and one step, whose content is replaced between replays."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import torch
from torch import Tensor

from ....rasterizer import TILE, Camera
from ...losses.motion_terms import FLOW_SCALE, FlowTarget
from ...views import WHOLLY
from ..drawn_tiles import Drawn

if TYPE_CHECKING:
    from ..objective import Now, Objective


class Kind(NamedTuple):
    """What steps have in common if one graph will do for them. scale, move, sh_degree: of the phase. spread, prior, flow: whether these
    terms are due. edges: whether the flow terms use those of the picture. target, drawn, measured, held, recorded: whether the frame has a
    `FlowTarget`, leaves tiles out, has measured depth, has depth of what moves, and has colours of its own. left_out, smooth: whether `Now`
    has these."""

    scale: float
    move: bool
    sh_degree: int
    spread: bool = False
    prior: bool = False
    flow: bool = False
    edges: bool = False
    target: bool = False
    drawn: bool = False
    measured: bool = False
    held: bool = False
    recorded: bool = False
    left_out: bool = False
    smooth: bool = False


class OneView:
    """Stands for the views of ``objective`` while a step of ``kind`` is captured; `show` fills in a frame and a step. Everything is on the
    device of the views."""

    def __init__(self, objective: Objective, kind: Kind) -> None:
        views = objective.views
        self._objective, self._views, self.kind = objective, views, kind
        self.width, self.height, self.background = views.width, views.height, views.background
        self.load_alpha, self.load_kept = views.load_alpha, views.load_kept
        device, (width, height) = views.device, views.size(kind.scale)
        self._sizes = [kind.scale, *([kind.scale * FLOW_SCALE] if kind.edges else []), *([FLOW_SCALE] * 2 if kind.target else [])]
        tiles = (-(-height // TILE), -(-width // TILE)) if kind.drawn else (0, 0)
        # All of them travel in one copy: cameras, times, numbers of the step, weights of tiles.
        counts = [*[9, 16] * len(self._sizes), 1, 1, 1, 1, 1, 1, tiles[0] * tiles[1]]
        self._numbers = torch.zeros(sum(counts), device=device)
        *parts, self._moment, self._later, self._row, self._left_out, self._smooth, self._step, weights = self._numbers.split(counts)
        self._cameras = [
            Camera(K.view(3, 3), pose.view(4, 4), *views.size(size), views.near)
            for size, K, pose in zip(self._sizes, parts[::2], parts[1::2])
        ]
        self._weights = weights.view(tiles)
        self._known: dict[int, Tensor] = {}  # the numbers of each frame, on the CPU
        self._backdrop = views.backdrop().to(device)
        self._pictures = {"colour": torch.zeros(height, width, 3, dtype=torch.uint8, device=device)}
        self._pictures |= {
            name: torch.zeros(height, width, dtype=torch.uint8, device=device)
            for name, there in (("alpha", views.load_alpha), ("kept", views.load_kept))
            if there
        }
        self._depth = torch.zeros(height, width, device=device) if kind.measured else None
        self._held = torch.zeros(2, height, width, device=device) if kind.held else None
        self._edges = torch.zeros(*views.size(kind.scale * FLOW_SCALE)[::-1], device=device) if kind.edges else None
        half = views.size(FLOW_SCALE)[::-1]
        self._flow = (torch.zeros(*half, 2, device=device), torch.zeros(half, device=device)) if kind.target else None

    def show(self, i: int, step: int, drawn: Drawn | None, row: int | None) -> None:
        """Put in frame ``i`` as step ``step`` sees it; ``row``: see `Objective.row`. Does not wait for a device that has the pictures."""
        views, objective, kind = self._views, self._objective, self.kind
        target = objective.motion_terms.flow_target(i) if self._flow is not None else None
        if i not in self._known:
            cameras = [views.rasterizer_camera(i, size) for size in self._sizes]
            if target is not None:
                cameras[-1] = target.next_camera
            numbers = [part.flatten() for camera in cameras for part in (camera.K, camera.cam_from_world)]
            others = [views.moment(i), 0.0 if target is None else float(target.later), -1.0 if row is None else float(row)]
            self._known[i] = torch.cat([*numbers, torch.tensor(others)])
        now = objective.now(step)
        parts = [self._known[i], torch.tensor([now.left_out or 0.0, now.smooth or 0.0, now.number])]
        if drawn is not None:
            parts.append(drawn.weight.flatten())
        self._numbers.copy_(torch.cat(parts), non_blocking=True)
        for name, picture in self._pictures.items():
            picture.copy_(views.stored(i, kind.scale, name))  # type: ignore[arg-type]
        if self._edges is not None:
            self._edges.copy_(views.edges(i, kind.scale * FLOW_SCALE))
        if target is not None and self._flow is not None:
            self._flow[0].copy_(target.flow)
            self._flow[1].copy_(target.edges)
        if self._depth is not None and objective.measured_depth is not None:
            measured = objective.measured_depth.static(i, *self._depth.shape)
            assert measured is not None
            self._depth.copy_(measured)
        if self._held is not None:
            held = objective.held(i, kind.scale, step)
            assert held is not None
            self._held.copy_(held)

    # What a step asks of its `Objective`.

    def now(self) -> Now:
        from ..objective import Now

        left_out, smooth = self._left_out[0] if self.kind.left_out else None, self._smooth[0] if self.kind.smooth else None
        return Now(left_out, smooth, self._step[0].long())

    def drawn(self) -> Drawn | None:
        return Drawn(self._weights > 0, self._weights) if self.kind.drawn else None

    def row(self) -> Tensor | None:
        return self._row.long() if self.kind.recorded else None

    def measured(self) -> Tensor | None:
        return self._depth

    def held(self) -> Tensor | None:
        return self._held

    def flow_target(self, i: int) -> FlowTarget | None:
        return None if self._flow is None else FlowTarget(self._cameras[-2], self._cameras[-1], self._later[0], *self._flow)

    # What a step asks of `Views`.

    def size(self, scale: float) -> tuple[int, int]:
        return self._views.size(scale)

    def window(self, i: int, scale: float = 1.0) -> None:
        """The whole image."""

    def rasterizer_camera(self, i: int, scale: float = 1.0, window: None = None) -> Camera:
        return self._cameras[self._sizes.index(scale)]

    def moment(self, i: int) -> Tensor:
        return self._moment[0]

    def backdrop(self) -> Tensor:
        return self._backdrop

    def target(self, i: int, scale: float = 1.0, window: None = None) -> Tensor:
        return self._pictures["colour"].float().div_(255.0)

    def alpha(self, i: int, scale: float = 1.0, window: None = None) -> Tensor:
        return self._pictures["alpha"].float().div_(255.0)

    def kept(self, i: int, scale: float = 1.0, window: None = None) -> Tensor | None:
        return None if self.load_kept is None else self._pictures["kept"].float().div_(255.0) >= WHOLLY

    def edges(self, i: int, scale: float = 1.0) -> Tensor:
        assert self._edges is not None
        return self._edges
