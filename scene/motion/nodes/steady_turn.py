"""Finds parts that turn too fast for gradients to follow: where the error stays, and the one rate of turning that explains it.

A part that turns by a large share of its texture between two frames blurs to a ball, and no small change of its motion makes the ball
sharper. So the rate is searched: at the right steady angular velocity, every place on the part's surface shows one colour to all views
that see it. A sphere stands in for the surface, and the images are blurred accordingly; training refines the result.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from torch import Tensor
from torch.nn import functional as F

from ...fibonacci import fibonacci_sphere
from ...views import Views

ERROR_SHARE = 0.15  # of the whole error: parts with less are left alone
CELLS = 50  # along the scene's longest side; the error is summed in each
SURFACE = 0.68  # radius of the sphere that stands in for the surface, as a share of the part's radius
BLUR = 0.3  # of the sphere's radius
PATCH = 64  # px across; a patch spans four and a half radii of the part
DIRECTIONS, FEW_DIRECTIONS = 300, 75  # on the sphere; a few rank the first candidates as well, in a fifth of the time
HOPELESS = 0.9  # if no first candidate brings the variance of colours below this share, none of them is near a turn
FASTEST = 22.0  # degrees a frame
WINDOW = 6  # frames to either side over which the first search expects one colour
ACCEPT = 0.8  # the variance of colours must fall below this share of that without turning, in windows and over the capture
MIN_FRAMES = 4 * WINDOW
ON_CPU, ON_GPU = 4000, 40_000  # turns and frames that are judged at a time; a GPU waits for the host with fewer


@dataclass(frozen=True)
class Part:
    """A compact cluster of Gaussians at rest with much of the error. centre [3] and radius in world units. share: of the whole error."""

    centre: np.ndarray
    radius: float
    share: float


@dataclass(frozen=True)
class SteadyTurn:
    """A steady turn. omega: [3] rad per frame of the sequence, world axes. offset: [3] world units, from the given path to the centre of
    the turn. gain: the variance of colours with the turn, as a share of that without it."""

    omega: np.ndarray
    offset: np.ndarray
    gain: float


def compact_parts(means: np.ndarray, error: np.ndarray) -> list[Part]:
    """Connected clusters of ``means`` [N, 3] whose attributed ``error`` [N] stands out, in decreasing order of their share of the error.

    The error is summed over cells of space, because growth puts Gaussians where the error is until each has about the same error.
    """
    if len(means) < 16 or error.sum() <= 0:
        return []
    low, high = np.percentile(means, 1, axis=0), np.percentile(means, 99, axis=0)
    spacing = float(np.median(cKDTree(means).query(means, 4)[0][:, 1:]))
    cell = max(float((high - low).max()) / CELLS, 1.5 * spacing, 1e-9)
    cells, of = np.unique(np.floor((means - low) / cell).astype(np.int64), axis=0, return_inverse=True)
    of = of.reshape(-1)
    mass = np.bincount(of, error, len(cells))
    hot = np.flatnonzero(mass > 3 * np.median(mass))
    pairs = cKDTree(cells[hot]).query_pairs(1.8, output_type="ndarray")  # neighbours, including diagonal ones
    graph = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(hot), len(hot)))
    _, label = connected_components(graph, directed=False)
    place = np.full(len(cells), -1)
    place[hot] = label
    parts = []
    for k in np.unique(label):
        members = np.flatnonzero(place[of] == k)
        weight = error[members]
        share = float(weight.sum() / error.sum())
        if share >= ERROR_SHARE and len(members) >= 16:
            centre = np.average(means[members], axis=0, weights=weight)
            radius = float(np.percentile(np.linalg.norm(means[members] - centre, axis=1), 90))
            parts.append(Part(centre, radius, share))
    return sorted(parts, key=lambda part: -part.share)


class TurnSearch:
    """Looks for the steady turn of one part.

    views: posed images. frames [n]: indices of views in order of time. path [n, 3]: observed path of the part's centre, world units.
    radius: of the part, world units. The work is done on the device of the views.
    """

    def __init__(self, views: Views, frames: np.ndarray, path: np.ndarray, radius: float) -> None:
        self.frames, self.count = frames, len(frames)
        self.device = torch.device(views.device)
        self.path = self._tensor(path)
        self.radius, self.surface = radius, SURFACE * radius
        self.cam_from_world, self.K = self._tensor(views.cam_from_world[frames]), self._tensor(views.K[frames])
        self.centres = self._tensor(views.centres()[frames])
        self.directions = {n: self._tensor(fibonacci_sphere(n)) for n in (FEW_DIRECTIONS, DIRECTIONS)}
        self.pixels, self.half = self._project(self.path)
        self.patches = torch.stack([self._patch(views, f) for f in range(self.count)]).to(self.device)

    def _tensor(self, values: np.ndarray) -> Tensor:
        return torch.tensor(values, dtype=torch.float32, device=self.device)

    def _project(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Pixels [n, 2] of one point a frame, and half a patch in px [n]."""
        cam = torch.einsum("fij,fj->fi", self.cam_from_world[:, :3, :3], points) + self.cam_from_world[:, :3, 3]
        z = cam[:, 2].clamp(min=1e-6)
        focal = torch.stack([self.K[:, 0, 0], self.K[:, 1, 1]], 1)
        return focal * cam[:, :2] / z[:, None] + self.K[:, :2, 2], 2.25 * self.radius * self.K[:, 0, 0] / z

    def _patch(self, views: Views, f: int) -> Tensor:
        """[3, PATCH, PATCH]: the part and its surroundings, blurred by `BLUR` of the sphere's radius."""
        half = float(self.half[f])
        scale = min(1.0, PATCH / (2 * half))
        image = views.target(int(self.frames[f]), 2.0 ** round(float(np.log2(max(scale, 1 / 16))))).cpu().numpy()
        shrink = image.shape[1] / views.width
        zoom = PATCH / (2 * half * shrink)
        u, v = (float(x) * shrink for x in self.pixels[f])
        affine = np.array([[zoom, 0, PATCH / 2 - zoom * u - 0.5 + 0.5 * zoom], [0, zoom, PATCH / 2 - zoom * v - 0.5 + 0.5 * zoom]])
        patch = cv2.warpAffine(image, affine, (PATCH, PATCH), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        sigma = BLUR * SURFACE * PATCH / 4.5
        return torch.from_numpy(cv2.GaussianBlur(patch, (0, 0), sigma)).permute(2, 0, 1)

    def variance(self, omega: Tensor, offset: Tensor, windows: Tensor, directions: int = DIRECTIONS) -> Tensor:
        """[C, W] mean over the sphere of the variance of the colours that the frames of each of ``windows`` [W, L] see (-1: no frame), for
        C turns ``omega`` [C, 3] in rad a frame about the path moved by ``offset`` [C or 1, 3]. directions: number of places on the
        sphere, one of the two constants."""
        f, inside = windows.clamp(min=0), windows >= 0
        middle = 0.5 * (f[:, :1] + windows.amax(1, keepdim=True))
        turns = rotation_vectors((f - middle)[..., None] * omega[:, None, None])
        normal = torch.einsum("cwfij,nj->cwfni", turns, self.directions[directions])
        centre = self.path[f] + offset[:, None, None]
        towards = F.normalize(self.centres[f] - centre, dim=-1)
        facing = ((normal * towards[..., None, :]).sum(-1) - 0.25).clamp(min=0) ** 2 * inside[..., None]
        pose = self.cam_from_world[f]
        cam = torch.einsum("wfij,cwfnj->cwfni", pose[..., :3, :3], centre[..., None, :] + self.surface * normal) + pose[..., None, :3, 3]
        focal = torch.stack([self.K[f, 0, 0], self.K[f, 1, 1]], -1)[..., None, :]
        pixel = focal * cam[..., :2] / cam[..., 2:].clamp(min=1e-6) + self.K[f, :2, 2][..., None, :]
        grid = (pixel - self.pixels[f][..., None, :]) / self.half[f][..., None, None]
        flat = grid.permute(1, 2, 0, 3, 4).flatten(0, 1)
        seen = F.grid_sample(self.patches[f.flatten()], flat, align_corners=False, padding_mode="border")
        seen = seen.unflatten(0, windows.shape).permute(3, 0, 1, 4, 2)
        weight, total = facing.sum(2), facing.sum((2, 3)).clamp(min=1e-6)
        mean_square = (facing * seen.square().sum(-1)).sum(2)
        square_mean = (facing[..., None] * seen).sum(2).square().sum(-1) / weight.clamp(min=1e-4)
        return (mean_square - square_mean).sum(2) / total

    def over_windows(self, omega: Tensor, offset: Tensor, half: int, directions: int = DIRECTIONS) -> Tensor:
        """[C] mean of `variance` over windows of ``half`` frames to either side that tile the sequence. offset: [C, 3], or [3] for all."""
        last, length = self.count - 1, 2 * half + 1
        starts = torch.arange(0, max(last - half, 1), length, device=self.device)
        windows = starts[:, None] + torch.arange(length, device=self.device)
        windows = torch.where(windows <= last, windows, -1)
        size = max(1, (ON_GPU if self.device.type == "cuda" else ON_CPU) // windows.numel())
        parts = zip(omega.split(size), offset.expand(len(omega), 3).split(size))
        return torch.cat([self.variance(turns, shifts, windows, directions).mean(1) for turns, shifts in parts])

    def find(self) -> SteadyTurn | None:
        """The turn that explains the colours best, or None if none is much better than no turn."""
        if self.count < MIN_FRAMES:
            return None
        degree = np.pi / 180
        candidates = lattice(FASTEST * degree, 5).to(self.device)
        candidates = candidates[candidates.norm(dim=1) <= FASTEST * degree]
        axes, still = torch.eye(3, device=self.device), torch.zeros(1, 3, device=self.device)
        offsets = torch.cat([still, axes, -axes]) * self.radius / 3
        with torch.no_grad():
            trials = [(self.over_windows(candidates, offset, WINDOW, FEW_DIRECTIONS), offset) for offset in offsets]
            resting = float(self.over_windows(still, offsets[0], WINDOW, FEW_DIRECTIONS))
        variance, offset = min(trials, key=lambda trial: float(trial[0].min()))
        if float(variance.min()) >= HOPELESS * resting:
            return None
        omega, offset = self._descend(candidates[variance.topk(6, largest=False).indices], offset)
        half = WINDOW
        while 2 * half < self.count - 1:
            # The blur tolerates an error of about 25 degrees at the ends of the window.
            half = min(3 * half, self.count // 2)
            step = 25 * degree / half
            with torch.no_grad():
                near = omega + lattice(4 * step, 4).to(self.device)
                omega = near[int(self.over_windows(near, offset, half).argmin())][None]
        omega, offset = self._descend(omega, offset, half)
        turning = omega[:1]
        with torch.no_grad():
            gains = [float(self.over_windows(turning, offset, h) / self.over_windows(still, offset, h)) for h in (WINDOW, half)]
        if not max(gains) < ACCEPT:
            return None
        return SteadyTurn(turning[0].cpu().numpy(), offset.cpu().numpy(), gains[-1])

    def _descend(self, omega: Tensor, offset: Tensor, half: int = WINDOW, steps: int = 40) -> tuple[Tensor, Tensor]:
        """The best of ``omega`` [C, 3] after gradient steps on each together with its own offset: ([1, 3], [3])."""
        turns = omega.clone().requires_grad_()
        shifts = (offset / self.radius).repeat(len(omega), 1).requires_grad_()
        best, best_turns, best_shifts = torch.full((len(omega),), torch.inf, device=self.device), turns.detach(), shifts.detach()
        learned, rates = (turns, shifts), (np.pi / 180 / half, 0.02)
        means, squares = ([torch.zeros_like(p, requires_grad=False) for p in learned] for _ in range(2))
        for number in range(1, steps + 1):
            values = self.over_windows(turns, shifts * self.radius, half)
            gradients = torch.autograd.grad(values.sum(), learned)
            with torch.no_grad():
                better = values < best
                best = torch.where(better, values, best)
                best_turns = torch.where(better[:, None], turns, best_turns)
                best_shifts = torch.where(better[:, None], shifts, best_shifts)
                # Adam. torch.optim's imports the compiler of torch on first use, which takes seconds.
                for p, gradient, rate, mean, square in zip(learned, gradients, rates, means, squares):
                    mean.lerp_(gradient, 0.1)
                    square.lerp_(gradient.square(), 0.001)
                    p -= rate / (1 - 0.9**number) * mean / ((square / (1 - 0.999**number)).sqrt() + 1e-8)
        first = int(best.argmin())
        return best_turns[first][None], best_shifts[first] * self.radius


def lattice(reach: float, steps: int) -> Tensor:
    """[(2 steps + 1)^3, 3] grid points of a cube around zero that extends ``reach`` to each side."""
    line = torch.linspace(-reach, reach, 2 * steps + 1)
    return torch.cartesian_prod(line, line, line)


def rotation_vectors(v: Tensor) -> Tensor:
    """Rotation matrices [..., 3, 3] of rotation vectors [..., 3], smooth at zero."""
    angle = v.square().sum(-1, keepdim=True).clamp(min=1e-16).sqrt()[..., None]
    zero = torch.zeros_like(v[..., 0])
    x, y, z = v.unbind(-1)
    cross = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).view(*v.shape, 3)
    return torch.eye(3, device=v.device) + torch.sin(angle) / angle * cross + (1 - torch.cos(angle)) / angle**2 * (cross @ cross)
