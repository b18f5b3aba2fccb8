"""A convex becomes a Gaussian that has its axes and follows what its points do."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from e4dgs.rasterizer import Convexes, Gaussians
from e4dgs.scene.convex_gaussians import GaussianFit, frames
from e4dgs.scene.fibonacci import fibonacci_sphere
from e4dgs.scene.formats.ply import joined
from e4dgs.scene.rotation import quats_to_matrices
from scipy.spatial.transform import Rotation

AXES = np.array([0.4, 0.2, 0.1])
TURN = Rotation.from_rotvec([0.3, -0.5, 0.2]).as_matrix()
SHEAR = torch.tensor([[1.2, 0.4, 0.0], [-0.1, 0.8, 0.3], [0.2, 0.0, 1.1]])
SHIFT = torch.tensor([0.5, -2.0, 1.0])


def convexes(points: torch.Tensor, opacity: float = 0.8) -> Convexes:
    one = torch.ones(len(points))
    return Convexes(points, 50 * one, 50 * one, opacity * one, sh=torch.zeros(len(points), 4, 3))


def ellipsoid() -> torch.Tensor:
    return torch.tensor(fibonacci_sphere(64) * AXES @ TURN.T + [1, 2, 3], dtype=torch.float32)[None]


def covariances(made: Gaussians) -> torch.Tensor:
    wide = quats_to_matrices(made.quats) * made.scales[:, None]
    return wide @ wide.transpose(1, 2)


def test_a_convex_becomes_a_gaussian_with_its_axes():
    made = GaussianFit.uniform(ellipsoid(), 1.0).gaussians(convexes(ellipsoid()))
    np.testing.assert_allclose(made.means[0], [1, 2, 3], atol=1e-2)
    np.testing.assert_allclose(np.sort(made.scales[0].numpy()), np.sort(AXES) / 3**0.5, rtol=0.05)
    rotation = Rotation.from_quat(made.quats[0].numpy()[[1, 2, 3, 0]]).as_matrix()
    assert abs(rotation[:, int(made.scales[0].argmax())] @ TURN[:, 0]) > 0.99
    torch.testing.assert_close(made.opacities, torch.tensor([0.8]))
    half = GaussianFit.uniform(ellipsoid(), 0.5).gaussians(convexes(ellipsoid()))
    torch.testing.assert_close(half.scales, 0.5 * made.scales)


@pytest.mark.parametrize("corners", [4, 6, 8])
def test_what_was_fitted_goes_along_with_an_affine_motion(corners):
    generator = torch.Generator().manual_seed(corners)
    rest = torch.randn(20, corners, 3, generator=generator)
    draw = lambda *shape: 0.3 * torch.randn(*shape, generator=generator)  # noqa: E731
    fit = GaussianFit(rest, draw(20, 3), draw(20, 3), draw(20))
    before, after = (fit.gaussians(convexes(points)) for points in (rest, rest @ SHEAR.T + SHIFT))
    torch.testing.assert_close(after.means, before.means @ SHEAR.T + SHIFT, atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(covariances(after), SHEAR @ covariances(before) @ SHEAR.T, atol=1e-4, rtol=1e-3)


def test_a_frame_s_square_is_the_covariance_whatever_the_motion():
    generator = torch.Generator().manual_seed(1)
    rest, now = torch.randn(2, 30, 6, 3, generator=generator)
    centred = now - now.mean(1, keepdim=True)
    F = frames(now, rest)
    torch.testing.assert_close(F @ F.transpose(1, 2), centred.transpose(1, 2) @ centred / 6, atol=1e-4, rtol=1e-4)


@pytest.mark.parametrize("mirror", [1.0, -1.0])
def test_axes_keep_their_names_while_a_convex_turns_and_stretches(mirror):
    """So that what is read between two times is on the way between them. On the way the longest axis becomes the shortest."""
    rest = torch.randn(20, 8, 3, generator=torch.Generator().manual_seed(2)) * torch.tensor([0.4, 0.2, 0.1 * mirror])
    fit = GaussianFit.uniform(rest, 0.7)
    first = fit.gaussians(convexes(rest))
    for k in range(1, 12):
        turn = torch.from_numpy(Rotation.from_rotvec([0.5 * k, -0.3 * k, 0.4 * k]).as_matrix()).float()
        made = fit.gaussians(convexes(rest @ turn.T + k * SHIFT))
        torch.testing.assert_close(made.scales, first.scales, atol=1e-4, rtol=1e-3)
        wanted = turn @ quats_to_matrices(first.quats)
        torch.testing.assert_close(quats_to_matrices(made.quats), wanted, atol=5e-3, rtol=0)
        axes = quats_to_matrices(first.quats)
        stretch = axes @ (torch.tensor([1 - 0.08 * k, 1.0, 1 + 0.4 * k])[:, None] * axes.transpose(1, 2))
        made = fit.gaussians(convexes(rest @ stretch.transpose(1, 2)))
        torch.testing.assert_close(made.scales, first.scales * torch.tensor([1 - 0.08 * k, 1.0, 1 + 0.4 * k]), atol=1e-4, rtol=1e-2)


def test_gradients_are_those_of_finite_differences_where_axes_do_not_turn():
    fit = GaussianFit.uniform(ellipsoid(), 0.7)
    weights = torch.tensor([[1.0, -2.0, 0.5]])

    def value(log_spread: torch.Tensor, offset: torch.Tensor, opacity: torch.Tensor) -> torch.Tensor:
        made = replace(fit, log_spread=log_spread, offset=offset, opacity=opacity).gaussians(convexes(ellipsoid()))
        return made.scales.square().sum() + (weights * made.means).sum() + made.opacities.sum()

    inputs = [x.clone().requires_grad_() for x in (fit.log_spread, fit.offset, fit.opacity)]
    gradients = torch.autograd.grad(value(*inputs), inputs)
    for k, (at, gradient) in enumerate(zip(inputs, gradients)):
        step = torch.full_like(at, 1e-2)
        both = [value(*(x + sign * step if j == k else x for j, x in enumerate(inputs))) for sign in (1, -1)]
        assert float(gradient.sum()) == pytest.approx(float((both[0] - both[1]).detach() / 2e-2), rel=2e-2, abs=1e-3)


def test_flat_doubled_and_hidden_convexes_break_nothing():
    flat = ellipsoid()[:, :4] * torch.tensor([1.0, 1.0, 0.0])
    points = torch.cat([flat, torch.ones(1, 4, 3), ellipsoid()[:, :4]])
    shown = convexes(points)
    shown.opacities[2] = 0.0
    fit = GaussianFit.uniform(points, 0.7)
    fit.opacity += 3.0
    made = fit.gaussians(shown)
    assert all(torch.isfinite(getattr(made, name)).all() for name in ("means", "quats", "scales", "opacities"))
    assert made.opacities[2] == 0 and made.opacities[0] > 0.8, "what is not there at a time does not come back"


def test_no_convexes_are_no_gaussians():
    none = GaussianFit.uniform(torch.zeros(0, 6, 3), 1.0).gaussians(convexes(torch.zeros(0, 6, 3)))
    five = Gaussians(torch.zeros(5, 3), torch.ones(5, 4), torch.ones(5, 3), torch.ones(5), sh=torch.zeros(5, 4, 3))
    assert len(joined(five, none).means) == 5
