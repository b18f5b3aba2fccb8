"""Gaussian rasterizer in plain torch: tiles, depth order, a dense block of (pixel, Gaussian) pairs at a time, autograd for gradients.

Written to be as fast as torch operations allow on a CPU, by the same rules as `e4dgs.rasterizer`:
- Exponents of all pairs of a block come from one matrix product: -1/2 d^T C^-1 d + ln o is linear in (1, x, y, xx, xy, yy).
- Lists of tiles are gathered once, so that their gradients are scattered once.
- Transmittance is exp(cumsum(ln(1 - alpha))), whose backward pass is half that of cumprod.
- Tiles with lists of like length walk them together, block by block, until all of their pixels have stopped.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from e4dgs.rasterizer import Camera, Convexes, Frame, Gaussians
from e4dgs.rasterizer.reference.blend import MAX_ALPHA, MIN_ALPHA, MIN_TRANSMITTANCE
from e4dgs.rasterizer.reference.gaussians import DILATION, clamp_without_gradient, rotations
from e4dgs.rasterizer.reference.sh import colors_of
from torch import Tensor

TILE = 8  # px
BLOCK = 64  # Gaussians of a tile's list that are evaluated together
TOGETHER = 64  # tiles that are evaluated together
FAINT = -20.0  # ln alpha of what is surely not blended, and of what pads a list
LOG_MAX_ALPHA = math.log(MAX_ALPHA)
BELOW_MIN_ALPHA = float(np.nextafter(np.float32(MIN_ALPHA), np.float32(0)))
LOG_MIN_TRANSMITTANCE = math.log(MIN_TRANSMITTANCE)


@dataclass
class Projected:
    """n Gaussians that may touch the image, front to back; all float32."""

    index: Tensor  # [n] int64, which ones
    conics: Tensor  # [n, 3] a, b, c of the exponent -(a dx^2 + b dx dy + c dy^2)
    centres: Tensor  # [n, 2] px
    log_opacities: Tensor  # [n]
    carried: Tensor  # [n, 5 + E] colour, one, depth, extras: what is blended
    extents: Tensor  # [n, 2] px, half of the box outside which alpha < 1/255


def rasterize_torch(
    camera: Camera,
    gaussians: Gaussians | None,
    convexes: Convexes | None = None,
    background: Tensor | None = None,
    tile: int = TILE,
    block: int = BLOCK,
    together: int = TOGETHER,
    antialiased: bool = False,
    tiles: Tensor | None = None,
) -> Frame:
    """Render in float32. Arguments and result as in `rasterize`; only Gaussians can be drawn, in the classic mode and in all tiles.
    Visibility is that of the image's box."""
    if tiles is not None:
        raise ValueError("the torch rasterizer draws all tiles")
    if antialiased:
        raise ValueError("the torch rasterizer has no antialiased mode")
    if gaussians is None or (convexes is not None and len(convexes.points)):
        raise ValueError("the torch rasterizer draws Gaussians, and nothing else")
    splats = project(camera, gaussians)
    pixels = blend_tiles(camera, splats, tile, block, together)
    alpha = pixels[..., 3]
    empty = alpha == 0
    color = pixels[..., :3] if background is None else pixels[..., :3] + (1 - alpha)[..., None] * background
    depth = torch.where(empty, 0.0, pixels[..., 4] / torch.where(empty, 1.0, alpha))
    visible = torch.zeros(len(gaussians.means), dtype=torch.bool)
    visible[splats.index] = True
    return Frame(color, alpha, depth, pixels[..., 5:], visible, torch.zeros(0, dtype=torch.bool))


def project(camera: Camera, gaussians: Gaussians) -> Projected:
    """Cull and project; the formulas of the reference, in float32."""
    rotation, translation = camera.cam_from_world[:3, :3], camera.cam_from_world[:3, 3]
    fx, fy, cx, cy = camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2]
    with torch.no_grad():
        z = gaussians.means @ rotation[2] + translation[2]
        index = ((z >= camera.near) & (gaussians.opacities > MIN_ALPHA)).nonzero()[:, 0]
        index = index[z[index].argsort(stable=True)]
    means = gaussians.means[index]
    x, y, z = (means @ rotation.T + translation).unbind(-1)
    slope_x, slope_y = clamp_without_gradient(x / z, camera.width, fx, cx), clamp_without_gradient(y / z, camera.height, fy, cy)
    zero = torch.zeros_like(z)
    jacobian = torch.stack([fx / z, zero, -fx * slope_x / z, zero, fy / z, -fy * slope_y / z], -1).view(-1, 2, 3)
    factors = jacobian @ rotation @ rotations(gaussians.quats[index]) * gaussians.scales[index][:, None, :]
    m1, m2 = factors.unbind(1)
    xx, yy, xy = m1.square().sum(-1) + DILATION, m2.square().sum(-1) + DILATION, (m1 * m2).sum(-1)
    # A sum of squares: xx yy - xy^2 would lose all digits of a needle's determinant.
    det = torch.linalg.cross(m1, m2).square().sum(-1) + DILATION * (xx + yy) - DILATION**2
    centres = torch.stack([fx * x / z + cx, fy * y / z + cy], -1)
    opacities = gaussians.opacities[index]
    with torch.no_grad():
        reach = torch.sqrt((2 * torch.log(opacities / MIN_ALPHA)).clamp(min=0))
        extents = torch.stack([reach * xx.sqrt(), reach * yy.sqrt()], -1)
        size = torch.tensor([camera.width, camera.height], dtype=centres.dtype)
        inside = ((centres + extents > 0) & (centres - extents < size)).all(1).nonzero()[:, 0]
    carried = [colors_of(gaussians, index, means, camera), torch.ones_like(z)[:, None], z[:, None]]
    if gaussians.extras is not None:
        carried.append(gaussians.extras[index])
    conics = torch.stack([yy, -2 * xy, xx], -1) * (0.5 / det)[:, None]
    return Projected(
        index[inside], conics[inside], centres[inside], opacities[inside].log(), torch.cat(carried, 1)[inside], extents[inside]
    )


@torch.no_grad()
def tile_lists(splats: Projected, tiles_x: int, tiles_y: int, tile: int) -> tuple[Tensor, Tensor]:
    """Which Gaussians [entries] each tile blends, tile by tile and front to back, and the length [tiles] of each tile's list."""
    most = torch.tensor([tiles_x, tiles_y]) - 1
    first = ((splats.centres - splats.extents) / tile).floor().long().clamp(min=0).minimum(most)
    last = ((splats.centres + splats.extents) / tile).floor().long().clamp(min=0).minimum(most)
    wide, high = (last - first + 1).unbind(1)
    counts = wide * high
    owner = torch.repeat_interleave(counts)
    place = torch.arange(len(owner)) - (counts.cumsum(0) - counts)[owner]
    numbers = (first[owner, 1] + place // wide[owner]) * tiles_x + first[owner, 0] + place % wide[owner]
    # Owners are in depth order, so a stable sort by tile leaves each list front to back.
    order = numbers.to(torch.int32).argsort(stable=True)
    return owner[order], numbers.bincount(minlength=tiles_x * tiles_y)


def blend_tiles(camera: Camera, splats: Projected, tile: int, block: int, together: int) -> Tensor:
    """[H, W, 5 + E] the carried values, blended front to back."""
    tiles_x, tiles_y = -(-camera.width // tile), -(-camera.height // tile)
    owner, lengths = tile_lists(splats, tiles_x, tiles_y, tile)
    coefficients = torch.cat([log_alphas(splats, owner, lengths, tiles_x, tile), torch.tensor([[FAINT, 0, 0, 0, 0, 0]])])
    carried = torch.cat([splats.carried, torch.zeros_like(splats.carried[:1])])
    y, x = torch.meshgrid(torch.arange(tile) + 0.5 - tile / 2, torch.arange(tile) + 0.5 - tile / 2, indexing="ij")
    x, y = x.reshape(-1), y.reshape(-1)
    basis = torch.stack([torch.ones_like(x), x, y, x * x, x * y, y * y], 1)  # [P, 6], the same for each tile

    # Tiles with lists of like length go together, padded to the longest of them.
    by_length = lengths.argsort(descending=True)
    starts = lengths.cumsum(0) - lengths
    groups, places = list(by_length.split(together)), []
    for group in groups:
        padded = max(1, -(-int(lengths[group[0]]) // block)) * block
        place = torch.arange(padded) + starts[group, None]
        places.append(torch.where(torch.arange(padded) < lengths[group, None], place, len(owner)))
    flat = torch.cat([place.reshape(-1) for place in places])
    sizes = [place.numel() for place in places]
    primitive = torch.cat([owner, torch.tensor([len(splats.carried)])])[flat]
    rows = zip(groups, coefficients[flat].split(sizes), carried[primitive].split(sizes))
    tiles = [blend_lists(basis, a.view(len(group), -1, 6), v.view(len(group), -1, carried.shape[1]), block) for group, a, v in rows]
    image = torch.cat(tiles)[by_length.argsort()]
    image = image.view(tiles_y, tiles_x, tile, tile, -1).transpose(1, 2).reshape(tiles_y * tile, tiles_x * tile, -1)
    return image[: camera.height, : camera.width]


def log_alphas(splats: Projected, owner: Tensor, lengths: Tensor, tiles_x: int, tile: int) -> Tensor:
    """[entries, 6] ln alpha of each entry as a polynomial in (1, x, y, xx, xy, yy), with the origin in the middle of its tile."""
    numbers = torch.repeat_interleave(lengths)
    middles = torch.stack([numbers % tiles_x, numbers // tiles_x], 1) * tile + tile / 2
    a, b, c, cx, cy, constant = torch.cat([splats.conics, splats.centres, splats.log_opacities[:, None]], 1)[owner].unbind(1)
    u, v = cx - middles[:, 0], cy - middles[:, 1]
    constant = constant - (a * u * u + b * u * v + c * v * v)
    return torch.stack([constant, 2 * a * u + b * v, b * u + 2 * c * v, -a, -b, -c], 1)


def blend_lists(basis: Tensor, coefficients: Tensor, carried: Tensor, block: int) -> Tensor:
    """[B, P, 5 + E] of B tiles: coefficients [B, n, 6] and carried [B, n, 5 + E] front to back, at the pixels of ``basis`` [P, 6]."""
    out = torch.zeros(len(carried), len(basis), carried.shape[2])
    before = torch.zeros(len(carried), len(basis), 1)  # logarithm of the transmittance
    for some, values in zip(coefficients.split(block, 1), carried.split(block, 1)):
        # Clamped from below too: torch's exp is several times slower where it underflows.
        exponents = (basis @ some.mT).clamp(FAINT, LOG_MAX_ALPHA)
        alphas = F.threshold(torch.exp(exponents), BELOW_MIN_ALPHA, 0.0)
        passed = torch.log(1 - alphas)
        after = torch.cumsum(passed, 2) + before
        weights = torch.exp(after - passed) * alphas
        before = after[..., -1:]
        if float(before.detach().min()) < LOG_MIN_TRANSMITTANCE:
            weights = weights * (after.detach() >= LOG_MIN_TRANSMITTANCE)
        out = out + weights @ values
        if float(before.detach().max()) < LOG_MIN_TRANSMITTANCE:
            break
    return out
