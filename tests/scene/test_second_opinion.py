"""What Kornia, which shares no code with ours, finds on the same pictures: SSIM, its gradient, and edges."""

import kornia
import numpy as np
import pytest
import torch
from e4dgs.scene.edges import LEVELS, edge_mask_canny, near_edges
from e4dgs.scene.losses.photometric import photometric_loss
from e4dgs.scene.metrics.ssim import ssim, ssim_map
from torch.nn import functional as F


def pair(height: int = 30, width: int = 37) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    truth = rng.uniform(size=(height, width, 3))
    return np.clip(truth + 0.2 * rng.normal(size=truth.shape), 0, 1), truth


def their_ssim(image: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
    """[1, 3, H, W], with zeros beyond the border as ours has them."""
    x, y = (F.pad(a.permute(2, 0, 1)[None].double(), (5, 5, 5, 5)) for a in (image, truth))
    return kornia.metrics.ssim(x, y, 11, 1.0, 1e-12, "valid")


def test_ssim():
    image, truth = pair()
    theirs = their_ssim(torch.from_numpy(image), torch.from_numpy(truth))[0].permute(1, 2, 0).numpy()
    assert np.abs(ssim_map(image, truth) - theirs).max() < 1e-9
    assert ssim(image, truth) == pytest.approx(theirs.mean(), abs=1e-10) and theirs.mean() < 0.95


def test_the_loss_of_training_and_its_gradient():
    image, truth = (torch.from_numpy(a).float() for a in pair())
    ours, theirs = image.clone().requires_grad_(), image.clone().requires_grad_()
    loss, their_loss = photometric_loss(ours, truth, 0.0, 1.0), 1 - their_ssim(theirs, truth).mean()
    loss.backward()
    their_loss.backward()
    assert loss.item() == pytest.approx(their_loss.item(), abs=1e-6)
    assert (ours.grad - theirs.grad).norm() < 1e-5 * theirs.grad.norm()


def disks() -> np.ndarray:
    """Eight disks of any colour on grey, with the noise of a camera."""
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:120, :160]
    image = np.full((120, 160, 3), 70.0)
    for _ in range(8):
        row, column, radius = rng.uniform(20, 100), rng.uniform(20, 140), rng.uniform(8, 25)
        image[(x - column) ** 2 + (y - row) ** 2 < radius**2] = rng.uniform(0, 255, 3)
    return np.clip(image + rng.normal(0, 2, image.shape), 0, 255).astype(np.uint8)


def their_edges(image: np.ndarray) -> np.ndarray:
    """Canny of the same blur and thresholds; their gradient of a step is an eighth of OpenCV's."""
    grey = kornia.color.rgb_to_grayscale(torch.from_numpy(image).permute(2, 0, 1)[None].float() / 255)
    low, high, _ = LEVELS[1]
    _, edges = kornia.filters.canny(grey, low / 255 / 8, high / 255 / 8, kernel_size=(7, 7), sigma=(1.0, 1.0))
    return edges[0, 0].numpy() > 0


def test_edges():
    ours, theirs = edge_mask_canny(disks()), their_edges(disks())
    assert ours.sum() > 500 and near_edges(theirs, 1.0)[ours].mean() > 0.99
    assert theirs[ours].mean() > 0.9, "most of them are the very pixels"
    assert near_edges(ours, 1.0)[theirs].mean() > 0.95
