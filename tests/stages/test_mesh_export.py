"""`export mesh` finds the surface of a scene whose shapes are known, in its colours, and nothing where there is none."""

import numpy as np
import pytest
import torch
from e4dgs.pipeline import StageError
from e4dgs.scene.model import Model
from e4dgs.scene.motion.static import Static
from e4dgs.scene.primitives import ConvexSet, GaussianSet
from e4dgs.stages.exports.mesh import Size, fuse, fuse_all, look, size_of
from e4dgs.stages.shared.frameset import FrameSet
from factory import Options, Sphere, make, write_dnerf
from open3d_here import needs_open3d
from run_stage import run_frames

RED, BLUE = (0.8, 0.2, 0.1), (0.1, 0.3, 0.9)


@pytest.fixture(scope="module")
def posed(tmp_path_factory):
    """A still cube and sphere, and the frames of 16 cameras around them."""
    folder = tmp_path_factory.mktemp("mesh")
    options = Options(backdrop="none", motion=0, times=16, width=192, height=192, val=0, test=0)
    capture = write_dnerf(make(options), folder / "capture")
    return capture, FrameSet(run_frames(capture.root, folder / "work").artifact, capture.root)


def on_surfaces(capture, count: int) -> np.ndarray:
    """``count`` points on each object, [2 count, 3]."""
    rng = np.random.default_rng(0)
    points = []
    for item in capture.synthetic.scene.objects:
        if isinstance(item.shape, Sphere):
            p = rng.normal(size=(count, 3))
            p *= item.shape.radius / np.linalg.norm(p, axis=1, keepdims=True)
        else:
            p, face = rng.uniform(-1, 1, (count, 3)), rng.integers(0, 3, count)
            p[np.arange(count), face] = np.sign(p[np.arange(count), face])
            p *= item.shape.half
        pose = item.motion.world_from_object(0.0)
        points.append(p @ pose[:3, :3].T + pose[:3, 3])
    return np.concatenate(points)


def distance(capture, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How far outside the nearest object each of ``points`` lies, world units, and which object that is."""
    found = []
    for item in capture.synthetic.scene.objects:
        pose = np.linalg.inv(item.motion.world_from_object(0.0))
        q = points @ pose[:3, :3].T + pose[:3, 3]
        if isinstance(item.shape, Sphere):
            found.append(np.linalg.norm(q, axis=1) - item.shape.radius)
        else:
            d = np.abs(q) - item.shape.half
            found.append(np.linalg.norm(d.clip(0), axis=1) + d.max(1).clip(max=0))
    nearest = np.abs(found).argmin(0)
    return np.take_along_axis(np.array(found), nearest[None], 0)[0], nearest


@pytest.fixture(scope="module")
def model(posed) -> Model:
    """Small Gaussians on the true surfaces."""
    points = on_surfaces(posed[0], 4000)
    gaussians = GaussianSet.from_points(points.astype(np.float32), np.repeat([RED, BLUE], 4000, axis=0), 0, opacity=0.95, max_scale=0.008)
    return Model(gaussians, ConvexSet.empty(6, 0), Static(), 0)


@needs_open3d
def test_vertices_lie_on_the_true_surface_in_its_colour(posed, model):
    capture, frames = posed
    size = size_of(model, frames, 0.0)
    made = fuse(model, frames, 0.0, size)
    assert 0.02 < size.voxel < 0.04, "1.5 pixels of 192 over 45 degrees, some 5 away"
    away, which = distance(capture, made.vertices)
    # The 0.3 px^2 of each Gaussian widen outlines by about a pixel, two thirds of a voxel.
    assert abs(np.median(away)) < 0.8 * size.voxel and np.percentile(np.abs(away), 95) < 1.7 * size.voxel
    assert np.abs(away).max() < 0.12, "the smaller object is 0.64 wide"
    for k, color in enumerate((RED, BLUE)):
        np.testing.assert_allclose(np.median(made.colors[which == k, :3], axis=0), color, atol=0.02)
    back = np.linalg.norm(on_surfaces(capture, 500)[:, None] - made.vertices[None], axis=2).min(1)
    # The floor's side of a cube that stands on it is seen by no camera above it.
    assert np.percentile(back, 75) < 2 * size.voxel, "what is seen has a surface"


@pytest.fixture
def gone(monkeypatch):
    """Times at which nothing is there, a set to add to."""
    times: set[float] = set()

    def looked(model, frames, i, t):
        seen = look(model, frames, i, t)
        return seen._replace(depth=np.zeros_like(seen.depth)) if t in times else seen

    monkeypatch.setattr("e4dgs.stages.exports.mesh.look", looked)
    return times


@needs_open3d
def test_a_time_without_a_surface_is_an_empty_mesh_among_others(posed, model, gone):
    gone |= {0.0, 1.0}
    size = Size(0.1, 20.0)
    made = list(fuse_all(model, posed[1], [0.0, 0.5, 1.0], size))
    assert [len(one.triangles) > 0 for one in made] == [False, True, False]
    assert (made[0].vertices.shape, made[0].colors.shape) == ((0, 3), (0, 4))
    with pytest.raises(StageError, match="no surface at time 1"):
        list(fuse_all(model, posed[1], [0.0, 1.0], size))


def test_the_size_is_that_of_several_times(posed, model, gone):
    gone |= {0.0, 0.5, 1.0}
    frames = posed[1]
    assert size_of(model, frames, 0.0, 0.25) == size_of(model, frames, 0.25)
    assert size_of(model, frames, *[0.0] * 3, 0.25, *[0.0] * 4) == size_of(model, frames, 0.25), "which none of the five is"
    with pytest.raises(StageError, match="solid at any of 3 times"):
        size_of(model, frames, 0.0, 0.5, 1.0)


@needs_open3d
def test_triangles_face_outwards(posed, model):
    capture, frames = posed
    made = fuse(model, frames, 0.0, Size(0.05, 20.0))
    a, b, c = (made.vertices[made.triangles[:, k]].astype(np.float64) for k in range(3))
    centre, normal = (a + b + c) / 3, np.cross(b - a, c - a)
    step = 0.01 * normal / np.linalg.norm(normal, axis=1, keepdims=True).clip(1e-12)
    outer, _ = distance(capture, centre + step)
    inner, _ = distance(capture, centre - step)
    assert (outer > inner).mean() > 0.97


def test_faint_pixels_are_not_fused(posed, model):
    _, frames = posed
    solid = look(model, frames, 0, 0.0)
    assert (solid.depth > 0).any()
    faint = Model(model.gaussians.select(torch.arange(len(model.gaussians))), model.convexes, Static(), 0)
    with torch.no_grad():
        faint.gaussians.opacity_logits.fill_(-6.0)
    assert not look(faint, frames, 0, 0.0).depth.any()
    with pytest.raises(StageError, match="sees anything solid"):
        size_of(faint, frames, 0.0)


@pytest.mark.parametrize(("behind", "fused"), [(1.0, False), (0.05, True)])
def test_a_pixel_that_shows_two_surfaces_is_not_fused(posed, behind, fused):
    frames = posed[1]
    forward = frames.cam_from_world[0, 2, :3]
    points = np.stack([0 * forward, behind * forward]).astype(np.float32)
    two = GaussianSet.from_points(points, np.array([RED, BLUE]), 0, max_scale=0.3)
    with torch.no_grad():
        two.log_scales.fill_(float(np.log(0.3)))
        two.opacity_logits[:] = torch.tensor([0.0, 6.0])  # one sees through the first
    assert look(Model(two, ConvexSet.empty(6, 0), Static(), 0), frames, 0, 0.0).depth.any() == fused


@needs_open3d
def test_voxels_that_do_not_fit_are_refused(posed, model, monkeypatch):
    monkeypatch.setattr("e4dgs.stages.exports.mesh.MOST_BLOCKS", 100)
    with pytest.raises(StageError, match="larger --voxel"):
        fuse(model, posed[1], 0.0, Size(0.01, 20.0))


@needs_open3d
def test_voxels_beside_which_the_scene_vanishes_should_be_smaller(posed, model):
    size = size_of(model, posed[1], 0.0)
    with pytest.raises(StageError, match=rf"give a smaller --voxel \(the pixels resolve {size.voxel:.3g}\)"):
        fuse(model, posed[1], 0.0, size._replace(voxel=100.0))


@needs_open3d
def test_a_few_solid_pixels_are_no_surface_and_no_failure_of_open3d(posed):
    """Open3D looks at every fourth pixel along each side, and refuses a view in which none of them is solid."""
    _, frames = posed
    dot = GaussianSet.from_points(np.zeros((1, 3), np.float32), np.array([RED]), 0, opacity=0.99, max_scale=0.02)
    model = Model(dot, ConvexSet.empty(6, 0), Static(), 0)
    seen = [look(model, frames, i, 0.0).depth for i in range(16)]
    assert all(depth.any() for depth in seen) and any(not depth[::4, ::4].any() for depth in seen)
    with pytest.raises(StageError, match="no surface at time 0"):
        fuse(model, frames, 0.0, Size(0.03, 20.0))
