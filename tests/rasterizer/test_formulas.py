"""The reference against the formulas, one pixel and one primitive at a time, with other tools (scipy's hull and rotations)."""

import math

import numpy as np
import torch
from e4dgs.rasterizer.reference.sh import sh_basis
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from .scenes import F64, Scene, random_scene, stack


def gaussian_alpha(scene: Scene, n: int, px: float, py: float) -> tuple[float, float]:
    """(alpha before the cap, z) by inverting the 2D covariance J W Sigma W^T J^T + 0.3 I."""
    g, K, pose = scene.gaussians, scene.camera.K.numpy(), scene.camera.cam_from_world.numpy()
    assert g is not None
    x, y, z = pose[:3, :3] @ g.means[n].numpy() + pose[:3, 3]
    if z < scene.camera.near:
        return 0.0, z
    w, i, j, k = g.quats[n].tolist()
    axes = Rotation.from_quat([i, j, k, w]).as_matrix() @ np.diag(g.scales[n].numpy())
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    t = scene.camera.width / (2 * fx)
    sx = np.clip(x / z, -cx / fx - 0.3 * t, (scene.camera.width - cx) / fx + 0.3 * t)
    t = scene.camera.height / (2 * fy)
    sy = np.clip(y / z, -cy / fy - 0.3 * t, (scene.camera.height - cy) / fy + 0.3 * t)
    J = np.array([[fx / z, 0, -fx * sx / z], [0, fy / z, -fy * sy / z]])
    covariance = J @ pose[:3, :3] @ axes @ axes.T @ pose[:3, :3].T @ J.T + 0.3 * np.eye(2)
    d = np.array([px - (fx * x / z + cx), py - (fy * y / z + cy)])
    return float(g.opacities[n]) * math.exp(-0.5 * d @ np.linalg.inv(covariance) @ d), z


def convex_alpha(scene: Scene, m: int, px: float, py: float) -> tuple[float, float]:
    """(alpha before the cap, z) by Eq. 4-7, with the normals as the cross products of corners in camera coordinates."""
    c, K, pose = scene.convexes, scene.camera.K.numpy(), scene.camera.cam_from_world.numpy()
    assert c is not None
    points = c.points[m].numpy() @ pose[:3, :3].T + pose[:3, 3]
    centroid = points.mean(0)
    if (points[:, 2] < scene.camera.near).any():
        return 0.0, centroid[2]
    plane = points[:, :2] / points[:, 2:]
    corners = ConvexHull(plane).vertices
    middle = np.append(plane[corners].mean(0), 1.0)  # a ray inside the silhouette
    d = np.array([(px - K[0, 2]) / K[0, 0], (py - K[1, 2]) / K[1, 1], 1.0])
    lengths, heights = [], []
    for i, j in zip(corners, np.roll(corners, -1)):
        u = np.cross(points[i], points[j])
        u /= np.linalg.norm(u)
        u *= -np.sign(u @ middle)  # outward
        heights.append(u @ (centroid[2] * d))
        lengths.append(np.linalg.norm(plane[j] - plane[i]))
    weights = len(points) * np.array(lengths) / np.sum(lengths)
    tau, kappa = float(c.tau[m]), float(c.kappa[m])
    S = math.log(np.sum(weights * np.exp(tau * np.array(heights)))) / tau
    return float(c.opacities[m]) / (1 + math.exp(kappa * S)), centroid[2]


def colour(owner: object, n: int, centre: np.ndarray, scene: Scene) -> np.ndarray:
    sh = owner.sh[n].numpy()  # type: ignore[attr-defined]
    pose = scene.camera.cam_from_world.numpy()
    direction = centre + pose[:3, :3].T @ pose[:3, 3]
    direction /= np.linalg.norm(direction)
    basis = sh_basis(torch.from_numpy(direction)[None], len(sh))[0].numpy()
    return np.maximum(0, basis @ sh + 0.5)


def render_by_hand(scene: Scene) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    g, c = scene.gaussians, scene.convexes
    assert g is not None and c is not None and g.extras is not None and c.extras is not None
    H, W = scene.camera.height, scene.camera.width
    color, alpha, depth, extras = np.zeros((H, W, 3)), np.zeros((H, W)), np.zeros((H, W)), np.zeros((H, W, g.extras.shape[1]))
    for row in range(H):
        for column in range(W):
            at = (column + 0.5, row + 0.5)
            layers = [
                (*gaussian_alpha(scene, n, *at)[::-1], colour(g, n, g.means[n].numpy(), scene), g.extras[n].numpy())
                for n in range(len(g.means))
            ]
            layers += [
                (*convex_alpha(scene, m, *at)[::-1], colour(c, m, c.points[m].numpy().mean(0), scene), c.extras[m].numpy())
                for m in range(len(c.points))
            ]
            T = 1.0
            for z, a, rgb, more in sorted(layers, key=lambda layer: layer[0]):
                a = min(0.99, a)
                if a < 1 / 255:
                    continue
                if T * (1 - a) < 0.99e-4:
                    break
                color[row, column] += T * a * rgb
                extras[row, column] += T * a * more
                depth[row, column] += T * a * z
                T *= 1 - a
            alpha[row, column] = 1 - T
            color[row, column] += T * scene.background.numpy()
    return color, alpha, np.divide(depth, alpha, out=np.zeros_like(depth), where=alpha > 0), extras


def test_a_mixed_scene_by_hand() -> None:
    scene = random_scene(4, gaussians=9, convexes=7, points=7, degree=3, extras=2, width=19, height=12, size=0.6)
    assert scene.gaussians is not None and scene.convexes is not None
    scene.gaussians.opacities[:4] = 1.0  # some pixels are capped, some stop
    scene.convexes.opacities[:3] = 1.0
    frame = scene.render()
    for got, want in zip((frame.color, frame.alpha, frame.depth, frame.extras), render_by_hand(scene)):
        assert torch.allclose(got, torch.from_numpy(want), atol=1e-11)
    assert 0.2 < float((frame.alpha > 0.1).double().mean()) < 1
    assert float(frame.alpha.max()) > 0.99


def test_sh_is_orthonormal_and_has_the_signs_of_3dgs() -> None:
    z, weights = np.polynomial.legendre.leggauss(8)
    phi = (np.arange(16) + 0.5) * 2 * math.pi / 16
    r = np.sqrt(1 - z**2)
    directions = np.stack([np.outer(r, np.cos(phi)), np.outer(r, np.sin(phi)), np.outer(z, np.ones(16))], -1).reshape(-1, 3)
    basis = sh_basis(torch.from_numpy(directions), 16).numpy()
    gram = basis.T @ (np.repeat(weights, 16)[:, None] * basis) * (2 * math.pi / 16)
    assert np.allclose(gram, np.eye(16), atol=1e-12)
    # With x to the right: bands in the order m = -l .. l, and an odd m changes its sign (Condon-Shortley).
    a, b, c = sh_basis(torch.eye(3, dtype=F64), 16)
    assert [float(a[3]) < 0, float(b[1]) < 0, float(c[2]) > 0, float(c[6]) > 0, float(a[8]) > 0] == [True] * 5
    assert [float(a[15]) < 0, float(b[9]) > 0, float(c[12]) > 0, float(a[13]) > 0, float(b[11]) > 0] == [True] * 5
    diagonal = sh_basis(torch.tensor([[1.0, 1.0, 1.0]], dtype=F64) / math.sqrt(3), 16)[0]
    assert [float(diagonal[n]) > 0 for n in (4, 5, 7, 10)] == [True, False, False, True]


def test_two_capped_layers_leave_1e_4_and_both_blend() -> None:
    """T = 0.01^2 = 1e-4 is above the stop at 0.99e-4; the third layer would cross it and is not blended."""
    frame = stack(5, 1.0).render()
    assert frame.visible_gaussians.tolist() == [True, True, False, False, False]
    assert math.isclose(float(frame.alpha), 1 - 1e-4, abs_tol=1e-12)


def test_the_layer_that_crosses_the_line_ends_the_pixel() -> None:
    """Behind it nothing is blended, not even a layer faint enough to stay above the line."""
    scene = stack(4, 1.0)
    scene = scene.having({"gaussians.opacities": torch.tensor([1.0, 0.95, 0.9, 0.1], dtype=F64)})
    assert scene.render().visible_gaussians.tolist() == [True, True, False, False]


def test_gaussians_come_before_convexes_on_ties_and_order_is_stable() -> None:
    scene = random_scene(1, gaussians=2, convexes=2, points=4, degree=None)
    assert scene.gaussians is not None and scene.convexes is not None
    scene.camera.cam_from_world = torch.eye(4, dtype=F64)
    scene.gaussians.means[:] = torch.tensor([0.0, 0.0, 4.0], dtype=F64)
    scene.gaussians.scales[:] = 0.5
    square = torch.tensor([[-1.0, -1, 4], [1, -1, 4], [1, 1, 4], [-1, 1, 4]], dtype=F64)
    scene.convexes.points[:] = square
    scene.gaussians.opacities[:] = 0.5
    scene.convexes.opacities[:] = 0.5
    scene.convexes.tau[:] = 50
    scene.convexes.kappa[:] = 50
    u, v = (round(float(x)) for x in scene.camera.K[:2, 2])
    weights = torch.autograd.functional.jacobian(
        lambda gc, cc: scene.having({"gaussians.colors": gc, "convexes.colors": cc}).render().color[v, u, 0],
        (scene.gaussians.colors, scene.convexes.colors),
    )
    assert float(weights[0][0, 0]) > float(weights[0][1, 0]) > float(weights[1][0, 0]) > float(weights[1][1, 0]) > 0


def test_depth_is_the_alpha_weighted_mean_z() -> None:
    scene = stack(2, 0.5)
    frame = scene.render()
    assert math.isclose(float(frame.depth), (0.5 * 2.0 + 0.25 * 6.0) / 0.75, rel_tol=1e-12)
