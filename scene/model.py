"""The 4D model of Eq. 1: Gaussians and convexes at rest, and the motion that carries both through time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..rasterizer import Camera, Convexes, Frame, Gaussians, rasterize
from .colour import CameraAffine
from .cuda.renders import Renders
from .motion.interface import Motion, Moved
from .motion.kinds import motion_class
from .motion.static import Static
from .motion.times import Time, check_time
from .primitives import ConvexSet, GaussianSet, PrimitiveSet
from .views import inside_image

AT_REST = Static()
MARGIN = 0.25  # of the size of an image, beyond which nothing is moved that comes to rest there


class Model:
    """Edge4DGS = {G, C} (Eq. 1) and a motion.

    gaussians, convexes: the two sets at rest, which carry what the motion needs. sh_degree: highest degree that is rendered.
    near: world units; nothing nearer to a camera was learned, so nothing nearer is drawn. background: RGB in [0, 1] used in training.
    affine: how each training camera records the model's colours; None if all record them alike. Held-out views use the mean camera.
    antialiased: the mode of `rasterize` for which the model is trained and in which it is drawn.
    clocks: by how much the pictures of a training camera, by its number, are later than their times, as a share of the capture; for cameras
    whose clock is off.
    """

    def __init__(
        self,
        gaussians: GaussianSet,
        convexes: ConvexSet,
        motion: Motion,
        sh_degree: int,
        near: float = 0.01,
        background: tuple[float, float, float] = (0.0, 0.0, 0.0),
        affine: CameraAffine | None = None,
        antialiased: bool = False,
        clocks: Mapping[int, float] | None = None,
    ) -> None:
        self._motion = motion
        self.gaussians = gaussians
        self.convexes = convexes
        self.sh_degree = sh_degree
        self.near = near
        self.background = background
        self.affine = affine
        self.antialiased = antialiased
        self.clocks = clocks or {}
        self._links: dict[str, tuple[PrimitiveSet, Tensor | None]] = {}
        self._stale: set[str] = set()
        self._moved: dict[str, tuple[Tensor, int, Tensor]] = {}
        self._renders = Renders()

    @property
    def gaussians(self) -> GaussianSet:
        return self._gaussians

    @gaussians.setter
    def gaussians(self, gaussians: GaussianSet) -> None:
        self._gaussians = gaussians.carrying(self._motion.attributes)

    @property
    def convexes(self) -> ConvexSet:
        return self._convexes

    @convexes.setter
    def convexes(self, convexes: ConvexSet) -> None:
        self._convexes = convexes.carrying(self._motion.attributes)

    @property
    def motion(self) -> Motion:
        """What moves the primitives. These carry what it needs, and nothing else."""
        return self._motion

    @motion.setter
    def motion(self, motion: Motion) -> None:
        self._motion = motion
        self.gaussians, self.convexes = self._gaussians, self._convexes

    @property
    def device(self) -> torch.device:
        return self.gaussians.device

    def to(self, device: str | torch.device) -> Model:
        """Move the model to ``device`` in place and return it. Cameras stay where they are: `rasterize` reads them from the CPU."""
        self.gaussians, self.convexes = self.gaussians.to(device), self.convexes.to(device)
        self.motion.to(device)
        if self.affine is not None:
            self.affine.to(device)
        self.relink()
        return self

    def at(self, t: Time, camera: Camera | None = None, move: bool = True, sh_degree: int | None = None) -> tuple[Gaussians, Convexes]:
        """Both kinds at time ``t`` in [0, 1], ready for `rasterize`, attached to autograd.

        Only dynamic primitives move. If a ``camera`` is given, and culling pays off for this motion, those whose rest position it cannot
        see are skipped. move=False renders the rest state. Raises ValueError if ``t`` is a number that is not in [0, 1].
        """
        check_time(t)
        degree = self.sh_degree if sh_degree is None else min(sh_degree, self.sh_degree)
        return (self.motion if move else AT_REST).primitives_at(self, t, camera, degree)

    def named_parameters(self) -> dict[str, Tensor]:
        """Everything that is trained, by name: "gaussians.means", ..., "motion.network.place.0.weight", ..."""
        named = {f"{s.KIND}.{name}": p for s in (self.gaussians, self.convexes) for name, p in s.parameters.items()}
        for kind, part in (("motion", self.motion), ("affine", self.affine)):
            named |= {} if part is None else {f"{kind}.{name}": p for name, p in part.named_parameters()}
        return named

    def in_rooms(self, rooms: Sequence[tuple[PrimitiveSet, Tensor, Tensor | None]]) -> Model:
        """This model with other Gaussians and convexes, of which it is known which move and what links them to the motion. A CUDA graph may
        be captured of what it computes."""
        self.motion.remember()
        twin = Model(*(primitives for primitives, _, _ in rooms), *self._rest_of_it())  # type: ignore[arg-type]
        for primitives, index, link in rooms:
            twin._moved[primitives.KIND] = primitives.dynamic, primitives.dynamic._version, index
            if link is not None:
                twin.set_links(primitives, link)
        return twin

    def with_gaussians(self, gaussians: GaussianSet) -> Model:
        """This model with other ``gaussians``; everything else is shared."""
        return Model(gaussians, self.convexes, *self._rest_of_it())

    def _rest_of_it(self) -> tuple[Any, ...]:
        return self.motion, self.sh_degree, self.near, self.background, self.affine, self.antialiased, self.clocks

    def in_view(self, t: Time, camera: Camera, tiles: Tensor | None = None, move: bool = True, fuller: float = 1.0) -> Tensor | None:
        """[m] int64: the Gaussians that ``camera`` may show at time ``t``, if that can be told without moving them all; else None.
        ``tiles``, ``fuller``: see `motion.in_view.in_view`."""
        if self.device.type != "cpu":
            return None  # a GPU would have to wait for the number found
        return self.motion.in_view(self.gaussians, camera, t if move else None, tiles, fuller)

    def moves(self) -> bool:
        """Whether any primitive is dynamic."""
        return any(len(self.moving(s)) for s in (self.gaussians, self.convexes))

    def opacities_at(self, t: Time, move: bool = True) -> Tensor:
        """[N] opacities of all Gaussians at time ``t``, in view or not, attached to autograd."""
        return (self.motion if move else AT_REST).opacities(self.gaussians, t)

    def carried(self, index: Tensor, t: float) -> Moved:
        """The Gaussians ``index`` as the motion carries them at time ``t``, whether they are dynamic or not."""
        return self.motion.carried(self, index, t)

    def relink(self) -> None:
        """Search again for the parts of the motion that carry each primitive; call this after rest positions have changed."""
        self._stale.update(self._links)

    def links(self, primitives: PrimitiveSet) -> Tensor | None:
        """`Motion.links` of all rest points of this model's Gaussians or convexes, cached until `relink` or until the set is replaced."""
        known = self._links.get(primitives.KIND)
        if known is not None and known[0] is primitives and primitives.KIND not in self._stale:
            return known[1]
        link, old = self.motion.links(primitives), known[1] if known is not None else None
        if link is not None and old is not None and link.shape == old.shape and link.device == old.device:
            link = old.copy_(link)  # a CUDA graph of a step reads it there
        self._links[primitives.KIND] = primitives, link
        self._stale.discard(primitives.KIND)
        return link

    def known_links(self, primitives: PrimitiveSet) -> Tensor | None:
        """`links`, but None if they would have to be searched."""
        known = self._links.get(primitives.KIND, (None, None))
        return known[1] if known[0] is primitives and primitives.KIND not in self._stale else None

    def set_links(self, primitives: PrimitiveSet, link: Tensor) -> None:
        """Continue with ``link`` from a checkpoint."""
        self._links[primitives.KIND] = primitives, link
        self._stale.discard(primitives.KIND)

    def moving(self, primitives: PrimitiveSet, camera: Camera | None = None) -> Tensor:
        """Indices [m] of the dynamic ones among this model's Gaussians or convexes, cached until that changes. With a ``camera``, if
        culling pays off for this motion, only of those whose rest position lies in its view, widened by `MARGIN`."""
        moving = primitives.dynamic
        if camera is not None and len(primitives) and self.motion.worth_culling:
            centres = primitives.rest_points().reshape(len(primitives), -1, 3).mean(1)
            return indices(moving & inside_image(camera, centres, MARGIN))
        # Who is dynamic seldom changes, and asking makes the host wait for a GPU.
        known = self._moved.get(primitives.KIND)
        if known is None or known[0] is not moving or known[1] != moving._version:
            known = self._moved[primitives.KIND] = moving, moving._version, indices(moving)
        return known[2]

    def render(self, camera: Camera, time: float, background: Tensor | None = None, backend: str = "auto") -> Frame:
        """One view at ``time`` in [0, 1], without gradients, as the mean camera would record it. ``background`` [3] in [0, 1]; None uses
        the model's own. The farther of the camera's and the model's near plane is used. Raises ValueError if ``time`` is not in [0, 1]."""
        check_time(time)
        camera = replace(camera, near=max(camera.near, self.near))
        background = torch.tensor(self.background) if background is None else background
        with torch.no_grad():
            if self.device.type == "cuda" and backend in ("auto", "cuda") and self.motion.replayable:
                return self._renders(self._draw, self._memory(), self.device, camera, time, background)
            return self._draw(camera, time, background, backend)

    def _draw(self, camera: Camera, time: Time, background: Tensor, backend: str = "auto") -> Frame:
        return rasterize(camera, *self.at(time, camera), background, backend=backend, antialiased=self.antialiased)  # type: ignore[arg-type]

    def _memory(self) -> tuple[object, ...]:
        """What a CUDA graph of a render reads, so that it can be told whether that is still there."""
        sets = self.gaussians, self.convexes
        parameters = (p.data_ptr() for s in sets for p in s.parameters.values())
        links = (None if link is None else link.data_ptr() for link in map(self.links, sets))
        return self.motion, *sets, *(s.dynamic._version for s in sets), *parameters, *links

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Every tensor of the model by name. Together with `config` this is all that `from_arrays` needs."""
        arrays = {**self.gaussians.to_arrays(), **self.convexes.to_arrays()}
        arrays |= {"field_" + name: p.cpu().numpy() for name, p in self.motion.state_dict().items()}
        if self.affine is not None:
            arrays |= {"affine_" + name: p.cpu().numpy() for name, p in self.affine.state_dict().items()}
        return arrays

    @property
    def config(self) -> dict[str, Any]:
        """JSON values that go with the arrays."""
        return {
            "sh_degree": self.sh_degree,
            "field": self.motion.config,
            "near": self.near,
            "background": list(self.background),
            "affine_cameras": None if self.affine is None else self.affine.cameras,
            "antialiased": self.antialiased,
            **({"clocks": sorted(self.clocks.items())} if self.clocks else {}),
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, np.ndarray], config: Mapping[str, Any]) -> Model:
        """Inverse of `to_arrays` and `config`. Raises KeyError if an array is missing."""
        state = {name.removeprefix("field_"): torch.tensor(np.asarray(arrays[name])) for name in arrays if name.startswith("field_")}
        motion = motion_from_state(state, config["field"])
        affine = None
        if config["affine_cameras"] is not None:
            affine = CameraAffine(config["affine_cameras"])
            affine.load_state_dict({name: torch.tensor(np.asarray(arrays["affine_" + name])) for name in affine.state_dict()})
        red, green, blue = (float(c) for c in config["background"])
        sets = GaussianSet.from_arrays(arrays, motion.attributes), ConvexSet.from_arrays(arrays, motion.attributes)
        clocks = {int(camera): float(late) for camera, late in config.get("clocks", [])}
        antialiased = bool(config.get("antialiased", False))  # models from before that mode are for the default one
        return cls(*sets, motion, int(config["sh_degree"]), float(config["near"]), (red, green, blue), affine, antialiased, clocks)


def motion_from_state(state: Mapping[str, Tensor], config: Mapping[str, Any] | None) -> Motion:
    """The motion with this `state_dict` and ``config``, which is None in models of earlier versions in which nothing moves. Raises KeyError
    if something is missing."""
    config = AT_REST.config if config is None else config
    return motion_class(config["kind"]).from_state(dict(state), dict(config))


def indices(chosen: Tensor) -> Tensor:
    """Where ``chosen`` [N] bool is True: [m] int64."""
    if bool(chosen.all()):  # the usual case in small scenes; takes a third of the time
        return torch.arange(len(chosen), device=chosen.device)
    return chosen.nonzero()[:, 0]
