"""How far Gaussians that were read from a file are from those that were written."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from e4dgs.rasterizer import Camera, Gaussians, rasterize
from e4dgs.scene.formats.ply import seen
from scipy.spatial import KDTree

BEST = 100.0  # dB, where nothing differs
KEPT = 0.01  # of the scene's size; where no position is farther off, the order is that of writing


def errors(written: Gaussians, read: Gaussians) -> dict[str, float]:
    """Largest errors over all Gaussians. Where a format has an order of its own, each is compared with its nearest in place, size, opacity
    and colour.

    lost: the difference in number between what of ``written`` can be seen and ``read``. shared: how many of ``read`` are the nearest of
    several, where Gaussians lie as near to each other as the format is exact. position: world units;
    relative: of the longest side of the box of all positions. scale: ln. rotation: degrees. opacity; color: of the constant coefficient of
    SH; sh: of the others, where both have them.
    """
    shown, back = seen(written), read
    assert shown.sh is not None and back.sh is not None
    if not len(shown.means) or not len(back.means):
        return {"gaussians": len(shown.means), "lost": abs(len(shown.means) - len(back.means))}
    size = float(np.ptp(shown.means.numpy(), axis=0).max())

    def place(one: Gaussians) -> np.ndarray:
        assert one.sh is not None
        looks = [one.scales.log() / 100, one.opacities[:, None] / 100, one.sh[:, 0] / 100]
        return torch.cat([one.means / max(size, 1e-30), *looks], 1).numpy()

    nearest = np.arange(len(shown.means))
    kept = len(shown.means) == len(back.means) and float((shown.means - back.means).norm(dim=1).max()) <= KEPT * size
    if not kept:
        _, nearest = KDTree(place(back)).query(place(shown))
    position = float((shown.means.double() - back.means[nearest].double()).norm(dim=1).max())
    quats = torch.nn.functional.normalize(back.quats[nearest].double(), dim=1)
    unlike = torch.minimum((shown.quats.double() - quats).norm(dim=1), (shown.quats.double() + quats).norm(dim=1))
    both = min(shown.sh.shape[1], back.sh.shape[1])
    rest = (shown.sh[:, 1:both] - back.sh[nearest, 1:both]).abs()
    return {
        "gaussians": len(shown.means),
        "lost": abs(len(shown.means) - len(back.means)),
        "shared": len(nearest) - len(np.unique(nearest)),
        "position": position,
        "relative": position / size if size else 0.0,
        "scale": float((shown.scales.log() - back.scales[nearest].log()).abs().max()),
        "rotation": float(np.degrees(4 * np.arcsin(np.clip(float(unlike.max()) / 2, 0, 1)))),
        "opacity": float((shown.opacities - back.opacities[nearest]).abs().max()),
        "color": float((shown.sh[:, 0] - back.sh[nearest, 0]).abs().max()),
        "sh": float(rest.max()) if rest.numel() else 0.0,
        "sh_coefficients": back.sh.shape[1],
    }


def psnr(written: Gaussians, read: Gaussians, cameras: Sequence[Camera], background: Sequence[float]) -> float:
    """dB between renders of both from ``cameras``, all pixels together."""
    behind = torch.tensor(list(background))
    squared = []
    with torch.no_grad():
        for camera in cameras:
            ours, theirs = (rasterize(camera, one, None, behind).color.clamp(0, 1) for one in (written, read))
            squared.append((ours.double() - theirs.double()).square().mean())
    return float(min(BEST, -10 * torch.log10(torch.stack(squared).mean().clamp(min=1e-30))))
