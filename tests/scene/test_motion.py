"""The model in time: what enters the field, what leaves it, rendered flow and its losses."""

import numpy as np
import pytest
import torch
from e4dgs.rasterizer import Camera
from e4dgs.scene.losses.flow_loss import data_flow_loss, interval_loss, project, rendered_flow
from e4dgs.scene.losses.flow_terms import Interval, MeasuredFlowTerm
from e4dgs.scene.losses.term import Measured, Now, Run
from e4dgs.scene.model import Model
from e4dgs.scene.motion.carrier import Carrier
from e4dgs.scene.motion.planes.field import DeformationField
from e4dgs.scene.motion.static import Static
from e4dgs.scene.primitives import ConvexSet, GaussianSet
from e4dgs.scene.rotation import quats_to_matrices
from e4dgs.scene.settings import TrainingSettings
from e4dgs.scene.training.control.dynamics import dynamic_from_masks, freeze_static_gaussians
from e4dgs.scene.views import Views

WIDTH, HEIGHT = 48, 32


class Path(Carrier):
    """A motion with a known path: dx = velocity t + acceleration t^2, for every position."""

    def __init__(self, velocity=(0.0, 0.0, 0.0), acceleration=(0.0, 0.0, 0.0)):
        super().__init__()
        self.velocity = torch.nn.Parameter(torch.tensor(velocity).float())
        self.acceleration = torch.nn.Parameter(torch.tensor(acceleration).float())

    worth_culling = True
    priors_at_places = True
    carry = DeformationField.carry  # by its displacement

    def forward(self, rest, t):
        from e4dgs.scene.motion.planes.displacement import Displacement

        dx = (self.velocity * t + self.acceleration * t * t).expand(len(rest), 3)
        return Displacement(dx, torch.tensor([1.0, 0, 0, 0]).expand(len(rest), 4), torch.zeros(len(rest), 3))


def camera():
    K = torch.tensor([[40.0, 0, WIDTH / 2], [0, 40.0, HEIGHT / 2], [0, 0, 1]])
    pose = torch.eye(4)
    pose[2, 3] = 4.0
    return Camera(K, pose, WIDTH, HEIGHT)


def model(motion=None, convex=False):
    points = np.array([[0.0, 0, 0], [0.3, 0.1, 0.2], [-0.4, 0, 0.5]])
    g = GaussianSet.from_points(points, np.full((3, 3), 0.5), 0, opacity=0.95)
    with torch.no_grad():
        g.log_scales.fill_(-1.5)
    rng = np.random.default_rng(0)
    hull = rng.normal(size=(1, 6, 3)) * 0.3
    c = ConvexSet.from_points(hull, np.full((1, 3), 0.5), 0) if convex else ConvexSet.empty(6, 0)
    return Model(g, c, motion or Static(), 0)


def views(frames=3):
    K = camera().K.numpy()[None].repeat(frames, 0).astype(float)
    poses = camera().cam_from_world.numpy()[None].repeat(frames, 0).astype(float)
    index = np.arange(frames)
    image = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    return Views(
        K, poses, np.linspace(0, 1, frames), np.zeros(frames, int), np.append(index[1:], -1), index, WIDTH, HEIGHT, lambda i: image
    )


def test_an_untrained_field_moves_nothing():
    field = DeformationField(torch.tensor([-1.0, -1, -1]), torch.tensor([1.0, 1, 1]), times=5)
    m = model(field)
    still, _ = model().at(0.0)
    for t in (0.0, 0.4, 1.0):
        now, _ = m.at(t)
        assert torch.equal(now.means, still.means) and torch.equal(now.scales, still.scales) and torch.equal(now.quats, still.quats)


@pytest.mark.parametrize(("low", "high"), [([0.0, 0, 0], [0.0, 0, 0]), ([-1.0, 0, 0], [1.0, 0, 1e-12]), ([-1e9] * 3, [1e9] * 3)])
def test_flat_and_huge_boxes_stay_finite(low, high):
    field = DeformationField(torch.tensor(low), torch.tensor(high), times=1)
    with torch.no_grad():
        field.head.weight.normal_()
    for t in (-1.0, 0.5, 2.0):
        out = field(torch.tensor([[0.0, 0, 0], [1e6, -1e6, 3]]), t)
        assert all(torch.isfinite(part).all() for part in out)


def test_only_what_moves_enters_the_field():
    """A field that cannot bear what stands still."""
    standing = torch.zeros(0, 3)

    class Touchy(Path):
        def forward(self, rest, t):
            assert len(rest) and not (rest[:, None] == standing).all(2).any()
            return super().forward(rest, t)

    m = model(Touchy((1.0, 0, 0)), convex=True)
    m.gaussians.dynamic = torch.tensor([False, True, False])
    m.convexes.dynamic = torch.tensor([True])
    standing = m.gaussians.means.detach()[[0, 2]]
    g, c = m.at(0.5)
    shift = (g.means - m.gaussians.means).detach()
    assert torch.allclose(shift, torch.tensor([[0.0, 0, 0], [0.5, 0, 0], [0, 0, 0]]), atol=1e-6)
    assert torch.allclose((c.points - m.convexes.points).detach(), torch.tensor([0.5, 0, 0]).expand(1, 6, 3), atol=1e-6)
    m.gaussians.dynamic[:] = False
    m.convexes.dynamic[:] = False
    standing = m.gaussians.means.detach()
    g, c = m.at(0.5)
    assert torch.equal(g.means, m.gaussians.means) and torch.equal(c.points, m.convexes.points)


def test_what_a_camera_cannot_see_skips_the_field():
    m = model(Path((1.0, 0, 0)))
    with torch.no_grad():
        m.gaussians.means[0] = torch.tensor([0.0, 0, -100.0])  # behind
        m.gaussians.means[1] = torch.tensor([50.0, 0, 0])  # beside
    shift = (m.at(1.0, camera())[0].means - m.gaussians.means).detach().norm(dim=1)
    assert shift.tolist() == pytest.approx([0.0, 0.0, 1.0])


def test_model_arrays_round_trip():
    field = DeformationField(torch.tensor([-1.0, -1, -1]), torch.tensor([1.0, 1, 1]), times=4, resolutions=(4, 8), channels=4, width=8)
    with torch.no_grad():
        field.head.weight.normal_()
    m = model(field, convex=True)
    again = Model.from_arrays(m.to_arrays(), m.config)
    a, b = m.render(camera(), 0.3), again.render(camera(), 0.3)
    assert torch.equal(a.color, b.color) and float(a.alpha.detach().max()) > 0.5


def test_rendered_flow_is_the_projected_displacement():
    m = model(Path((0.5, 0.0, 0.0)))
    flow, alpha = rendered_flow(m, camera(), 0.0, camera(), 0.2)
    solid = alpha > 0.5
    now, later = project(camera(), m.at(0.0)[0].means), project(camera(), m.at(0.2)[0].means)
    expected = (later - now).detach()
    assert solid.any()
    assert float(flow[solid][:, 0].min().detach()) >= float(expected[:, 0].min()) - 1e-4
    assert float(flow[solid][:, 0].max().detach()) <= float(expected[:, 0].max()) + 1e-4
    assert flow[..., 1].detach().abs().max() < 1e-4


def test_interval_loss_is_zero_for_steady_motion_and_grows_with_acceleration():
    edges = torch.ones(HEIGHT, WIDTH)
    steady = interval_loss(model(Path((0.0, 0, 0))), camera(), 0.0, 0.2, edges)
    small = interval_loss(model(Path((0, 0, 0), (0.5, 0, 0))), camera(), 0.0, 0.2, edges)
    large = interval_loss(model(Path((0, 0, 0), (1.0, 0, 0))), camera(), 0.0, 0.2, edges)
    assert float(steady.detach()) < 1e-8
    assert float(large.detach()) == pytest.approx(4 * float(small.detach()), rel=0.1)


def test_flow_terms_reach_the_motion_and_nothing_else():
    motion = Path((0.3, 0.1, 0.0), (0.4, 0.2, 0.1))
    m = model(motion)
    edges = torch.ones(HEIGHT, WIDTH)
    interval_loss(m, camera(), 0.0, 0.2, edges).backward()
    assert motion.acceleration.grad.norm() > 0
    assert m.gaussians.opacity_logits.grad is None and m.gaussians.log_scales.grad is None
    motion.zero_grad()
    m.gaussians.means.grad = None
    m.gaussians.dynamic[:] = False
    loss = data_flow_loss(m, camera(), 0.0, camera(), 0.2, torch.zeros(HEIGHT, WIDTH, 2), edges)
    loss.backward()
    assert motion.acceleration.grad is None or motion.acceleration.grad.abs().max() == 0
    assert m.gaussians.means.grad.abs().max() == 0


def due(model, total=100, frames=3, measured=None, **settings):
    """Steps of ``total`` that evaluate L_interval, and those that compare measured flow."""
    run = Run(views(frames), TrainingSettings(flow_every=8, **settings), DeformationField.recipe, 1.0, False, total, 0, Measured(measured))
    terms = Interval(run), MeasuredFlowTerm(run)
    return [[n for n in range(0, total, term.every) if term.due(model, Now(0, n, 1.0, True))] for term in terms]


def test_steps_evaluate_flow_terms_only_if_they_can_tell_something():
    bends, steady = model(Path()), model(Path())
    steady.motion.steady = True
    late = list(range(32, 100, 8))  # from 30 % of the steps
    assert due(bends) == [late, []]
    assert due(bends, 106)[0][0] == 32 and due(bends, 107)[0][0] == 40
    assert due(bends, interval_weight=0.0) == due(bends, frames=2) == due(steady) == due(model()) == [[], []]
    assert due(bends, interval_weight=0.0, measured=lambda i: None) == due(steady, measured=lambda i: None) == [[], late]
    assert due(bends, interval_weight=0.0, measured=lambda i: None, data_flow_weight=0.0) == [[], []]
    assert Interval.whole_image and MeasuredFlowTerm.whole_image, "steps with either draw whole images"


def test_interval_gradient_matches_central_differences():
    """One Gaussian: the flow of every pixel that it covers is its own, so holding the blending weights fixed changes nothing."""
    edges = torch.ones(HEIGHT, WIDTH)

    def loss(motion):
        m = model(motion)
        m.gaussians = m.gaussians.select(torch.tensor([0]))
        return interval_loss(m, camera(), 0.0, 0.2, edges)

    motion = Path((0.3, 0.1, 0.0), (0.4, 0.2, 0.1))
    loss(motion).backward()

    def value(axis, shift):
        acceleration = [0.4, 0.2, 0.1]
        acceleration[axis] += shift
        return float(loss(Path((0.3, 0.1, 0.0), acceleration)).detach())

    for axis in range(3):
        numeric = (value(axis, 1e-2) - value(axis, -1e-2)) / 2e-2
        assert float(motion.acceleration.grad[axis]) == pytest.approx(numeric, rel=1e-2, abs=1e-3)


def test_static_gaussians_leave_the_field_where_they_stand():
    m = model(Path((1e-4, 0, 0)))
    before = m.at(0.5)[0].means.detach()
    assert freeze_static_gaussians(m, views()) == 3
    assert not m.gaussians.dynamic.any()
    assert torch.allclose(m.at(0.5)[0].means, before, atol=1e-4)
    moving = model(Path((0.5, 0, 0)))
    assert freeze_static_gaussians(moving, views()) == 0


def test_gaussians_that_leave_the_field_keep_the_orientation_and_the_size_that_it_gave_them():
    class Turning(Path):
        def forward(self, rest, t):
            turned, larger = torch.tensor([0.8, 0.0, 0.6, 0.0]), torch.tensor([0.3, -0.2, 0.1])
            return super().forward(rest, t)._replace(dr=turned.expand(len(rest), 4), ds=larger.expand(len(rest), 3))

    m = model(Turning())
    with torch.no_grad():
        m.gaussians.quats.normal_(generator=torch.Generator().manual_seed(0))
    before = m.at(0.5)[0]
    assert freeze_static_gaussians(m, views()) == 3
    after = m.at(0.5)[0]
    assert torch.allclose(quats_to_matrices(after.quats), quats_to_matrices(before.quats), atol=1e-6)
    assert torch.allclose(after.scales, before.scales, rtol=1e-6)
    assert not torch.allclose(before.scales, model().at(0.5)[0].scales, rtol=0.05), "the field has changed them"


@pytest.mark.parametrize(("share", "leave"), [(1.0, 3), (1.01, 0)])
def test_static_gaussians_leave_only_where_they_are_enough(share, leave):
    m = model(Path((1e-4, 0, 0)))
    assert freeze_static_gaussians(m, views(), share=share) == leave
    assert int((~m.gaussians.dynamic).sum()) == leave


def test_fixed_cameras_tell_what_moves():
    mask = np.zeros((HEIGHT, WIDTH), np.uint8)
    mask[:, WIDTH // 2 :] = 255
    points = np.array([[-0.5, 0, 0], [0.5, 0, 0], [0, 0, -100.0]])
    assert dynamic_from_masks(points, views(), [(0, mask)], 0.3).tolist() == [False, True, True]


@pytest.mark.parametrize(("share", "moves"), [(0.5, True), (0.51, False)])
def test_a_seed_may_move_from_its_share_of_looks_on(share, moves):
    points = np.array([[0.0, 0, 0]])
    nothing, everything = (np.full((HEIGHT, WIDTH), value, np.uint8) for value in (0, 255))
    assert dynamic_from_masks(points, views(), [(0, nothing), (1, everything)], share).tolist() == [moves]


def turning_field(quats, centre_shift):
    """A field whose heads are constant: everything turns by ``quats`` about the box's centre and shifts."""
    field = DeformationField(torch.tensor([-1.0, -1, -1]), torch.tensor([1.0, 1, 3]), times=5, resolutions=(4,), channels=4, width=8)
    with torch.no_grad():
        field.head.bias[:3] = torch.tensor(centre_shift) / field.reach
        field.head.bias[3:7] = torch.tensor(quats) - torch.tensor([1.0, 0, 0, 0])
    return field


def test_the_field_moves_a_body_rigidly():
    half = 0.5**0.5
    field = turning_field([half, 0, 0, half], [0.1, 0.2, 0.3])  # a quarter turn about z through (0, 0, 1)
    rest = torch.tensor([[0.5, 0.0, 1.0], [0.0, 0.0, 2.0]])
    dx, dr, ds = field(rest, 0.3)
    assert torch.allclose(rest + dx, torch.tensor([[0.1, 0.7, 1.3], [0.1, 0.2, 2.3]]), atol=1e-6)
    assert torch.allclose(dr, torch.tensor([half, 0, 0, half]).expand(2, 4)) and not ds.any()
    R = quats_to_matrices(dr)
    m = model(field)
    turned = quats_to_matrices(m.at(0.3)[0].quats).detach()
    assert torch.allclose(turned, R[:1] @ quats_to_matrices(m.gaussians.quats).detach(), atol=1e-6)


def test_gradients_of_rest_positions_turn_with_the_body():
    half = 0.5**0.5
    m = model(turning_field([half, 0, 0, half], [0.0, 0, 0]))
    m.at(0.3)[0].means[:, 1].sum().backward()  # what is y now was x at rest
    assert torch.allclose(m.gaussians.means.grad, torch.tensor([1.0, 0, 0]).expand(3, 3), atol=1e-6)


class Swirl(Path):
    """Rigid motion numbers that grow with x, and with the square of time."""

    def rigid_motion(self, rest, t):
        out = torch.zeros(len(rest), 7)
        out[:, 0], out[:, 1] = rest[:, 0], 3 * t * t
        return out


def test_rigidity_is_zero_for_neighbours_that_move_alike_and_inertia_measures_acceleration():
    rest = torch.rand(64, 3, generator=torch.Generator().manual_seed(0))
    beside, along = rest + torch.tensor([0.0, 0.3, 0]), rest + torch.tensor([0.3, 0, 0])
    rigidity, inertia = DeformationField.priors(Swirl(), rest, beside, 0.5, 0.1)
    assert float(rigidity) == 0 and float(inertia) == pytest.approx(3 * 2 * 0.1**2, rel=1e-4)
    assert float(DeformationField.priors(Swirl(), rest, along, 0.0, 0.1)[0]) == pytest.approx(0.3, rel=1e-5)
    assert float(DeformationField.priors(Swirl(), rest, along, 0.0, 1.0)[1]) == 0  # one step spans the capture: nothing to compare
