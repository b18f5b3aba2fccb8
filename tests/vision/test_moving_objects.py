"""Masks of what moves against rendered truth; residuals against flow made by hand; noise, thresholds, and inputs that say nothing."""

import cv2
import numpy as np
import pytest
from e4dgs.vision.flow.two_way import FlowPair, consistency, dis_flow
from e4dgs.vision.moving.evidence import NOISE_FACTOR, Evidence, evidence, spread_of_flow
from e4dgs.vision.moving.fixed_camera import FixedCameraMasks, fixed_camera_masks
from e4dgs.vision.moving.moving_masks import chain, frame_evidence, moving_mask, moving_masks
from e4dgs.vision.moving.residual import Neighbour, Residual, rigid_residual
from e4dgs.vision.moving.two_view import epipolar_residual, sampson, two_view
from e4dgs.vision.moving.uncalibrated import uncalibrated_residual
from factory import Options, make, optical_flow, render, to_uint8

WIDTH, HEIGHT, TIMES, FRAMES = 160, 120, 13, 9  # the first frames of a slow walk
K = np.array([[120.0, 0, 80.0], [0, 120.0, 60.0], [0, 0, 1]])
BLOCK = np.zeros((HEIGHT, WIDTH), bool)
BLOCK[40:75, 60:100] = True


class Room:
    """A room that one camera passes, at 160x120: pictures, poses, exact flow, and what moves."""

    def __init__(self, motion: float) -> None:
        options = Options(backdrop="room", rig="path", times=TIMES, motion=motion, width=WIDTH, height=HEIGHT, samples=2, fov_degrees=60.0)
        synthetic = make(options)
        self.views, self.scene = synthetic.views, synthetic.scene
        truths = [render(self.scene, v.camera, v.time, 2) for v in self.views[:FRAMES]]
        self.pictures = [np.ascontiguousarray(to_uint8(t.image)[..., :3]) for t in truths]
        self.moves = [(t.object > 0) if motion else np.zeros_like(t.object, bool) for t in truths]
        self.K = np.stack([v.camera.K for v in self.views[:FRAMES]])
        self.poses = np.stack([v.camera.cam_from_world for v in self.views[:FRAMES]])

    def flow(self, i: int, j: int) -> tuple[np.ndarray, np.ndarray]:
        a, b = self.views[i], self.views[j]
        exact = optical_flow(self.scene, a.camera, a.time, b.time, b.camera)
        return exact.flow.astype(np.float32), np.where(exact.visible, 255, 0).astype(np.uint8)

    def measured(self) -> list[FlowPair]:
        pairs = []
        for a, b in zip(self.pictures, self.pictures[1:]):
            forward, backward = dis_flow(a, b), dis_flow(b, a)
            pairs.append(FlowPair(forward, backward, consistency(forward, backward)))
        return pairs

    def neighbours(self, i: int, others: tuple[int, ...]) -> list[Neighbour]:
        return [Neighbour(*self.flow(i, j), self.K[j], self.poses[j]) for j in others]


@pytest.fixture(scope="module")
def room() -> Room:
    return Room(1.0)


@pytest.fixture(scope="module")
def static_room() -> Room:
    return Room(0.0)


def iou(mask: np.ndarray, truth: np.ndarray) -> float:
    return np.count_nonzero((mask > 0) & truth) / max(1, np.count_nonzero((mask > 0) | truth))


def pose(x: float = 0.0, y: float = 0.0, z: float = 0.0, turn: float = 0.0) -> np.ndarray:
    """cam_from_world of a camera at (x, y, z), turned about y by `turn` radians."""
    c, s = np.cos(turn), np.sin(turn)
    result = np.eye(4)
    result[:3, :3] = [[c, 0, s], [0, 1, 0], [-s, 0, c]]
    result[:3, 3] = -result[:3, :3] @ [x, y, z]
    return result


def depths() -> np.ndarray:
    """A wall that recedes, with a step in it: no plane explains it."""
    depth = np.full((HEIGHT, WIDTH), 6.0) + np.linspace(0, 3, WIDTH)
    depth[:, :50] -= 2.0
    depth[80:] -= np.linspace(0, 2, 40)[:, None]
    return depth


def seen_from(cam_from_world: np.ndarray, shift: tuple[float, float, float] = (0, 0, 0), noise: float = 0.0, seed: int = 0) -> Neighbour:
    """Flow from the camera at the origin to another, of `depths()`; the block moves by `shift` in the world."""
    u, v = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    rays = np.stack([u, v, np.ones_like(u)], -1) @ np.linalg.inv(K).T
    points = rays * depths()[..., None] + BLOCK[..., None] * np.asarray(shift, float)
    local = points @ cam_from_world[:3, :3].T + cam_from_world[:3, 3]
    landed = local @ K.T
    flow = landed[..., :2] / landed[..., 2:] - np.stack([u, v], -1)
    flow += np.random.default_rng(seed).normal(0, noise, flow.shape)
    return Neighbour(flow.astype(np.float32), np.full((HEIGHT, WIDTH), 255, np.uint8), K, cam_from_world)


# --- masks of a rendered scene


@pytest.mark.parametrize("posed", [True, False])
def test_exact_flow_gives_the_moving_objects(room, posed):
    found = frame_evidence(room.neighbours(4, (0, 2, 6, 8)), *((room.K[4], room.poses[4]) if posed else ()))
    assert iou(moving_mask(room.pictures[4], found), room.moves[4]) > (0.85 if posed else 0.7)


def test_measured_flow_gives_masks_of_every_frame(room):
    masks = list(moving_masks(room.pictures.__getitem__, room.measured(), room.K, room.poses))
    assert len(masks) == FRAMES and all(m.dtype == np.uint8 and m.shape == (HEIGHT, WIDTH) for m in masks)
    # the box turns towards the camera's own parallax, so parts of it cannot be told from static points; what is masked, moves
    assert np.mean([iou(m, truth) for m, truth in zip(masks[1:6], room.moves[1:6])]) > 0.55
    assert np.mean([truth[m > 0].mean() for m, truth in zip(masks[1:6], room.moves[1:6])]) > 0.9


@pytest.mark.parametrize("posed", [True, False])
def test_a_static_scene_has_no_mask(static_room, posed):
    poses = (static_room.K[:5], static_room.poses[:5]) if posed else ()
    masks = list(moving_masks(static_room.pictures.__getitem__, static_room.measured()[:4], *poses))
    assert np.mean([mask > 0 for mask in masks]) < 0.01


def test_the_result_is_the_same_twice(room):
    first, second = (uncalibrated_residual(room.neighbours(3, (2, 4))) for _ in range(2))
    assert np.array_equal(first.error, second.error)


def test_a_pair_that_was_not_measured_and_a_frame_without_pose(room):
    pairs, poses = room.measured(), room.poses.copy()
    pairs[0] = None
    poses[3] = np.nan
    masks = list(moving_masks(room.pictures.__getitem__, pairs, room.K, poses))
    assert not masks[0].any() and not masks[3].any()  # nothing is known about the first, and the fourth has no pose
    assert iou(masks[5], room.moves[5]) > 0.5
    assert not any(mask.any() for mask in moving_masks(room.pictures.__getitem__, [None] * (FRAMES - 1), room.K, room.poses))


def test_pairs_are_read_as_needed(room):
    """Long captures are streamed: no more pairs are read before the first mask than reach it."""
    read = set()

    class Pairs(list):
        def __getitem__(self, i):
            read.add(i)
            return super().__getitem__(i)

    stream = moving_masks(room.pictures.__getitem__, Pairs(room.measured()), room.K, room.poses, gaps=(1, 2))
    next(stream)
    assert max(read) <= 2


# --- residuals of flow made by hand


@pytest.mark.parametrize(
    "cameras",
    [
        [pose(0.3), pose(-0.3)],  # translation
        [pose(turn=0.05), pose(turn=-0.04)],  # rotation alone: no baseline
        [pose(), pose()],  # a camera that does not move
        [pose(1e-9), pose(-1e-9)],  # a baseline that means nothing
        [pose(z=0.4), pose(z=-0.4)],  # along the view
    ],
)
def test_static_points_have_no_residual_and_moving_ones_have_theirs(cameras):
    static = rigid_residual(K, np.eye(4), [seen_from(camera) for camera in cameras])
    assert static.error.max() < 2e-3 and static.weight.min() == 1.0
    moved = rigid_residual(K, np.eye(4), [seen_from(camera, (0.0, sign * 0.2, 0)) for camera, sign in zip(cameras, (1, -1))])
    assert moved.error[BLOCK].min() > 0.5 and moved.error[~BLOCK].max() < 2e-3


def test_motion_along_the_epipolar_line_shows_with_a_second_neighbour():
    one = seen_from(pose(0.3), (-0.1, 0, 0))
    assert rigid_residual(K, np.eye(4), [one]).error.max() < 2e-3  # a nearer static point would look the same
    other = seen_from(pose(-0.3), (-0.1, 0, 0))
    assert rigid_residual(K, np.eye(4), [one, other]).error[BLOCK].min() > 0.5
    # the same without poses: each pair alone is blind, the common fit is not
    pairs = [seen_from(pose(0.3), (-0.1, 0, 0), 0.02, 1), seen_from(pose(-0.3, 0.1), (-0.1, 0, 0), 0.02, 2)]
    blind, joint = epipolar_residual(pairs).error, uncalibrated_residual(pairs).error
    assert np.median(joint[BLOCK]) > 0.5 and np.median(joint[~BLOCK]) < 0.1
    assert np.median(joint[BLOCK]) > 2 * np.median(blind[BLOCK])


def test_a_point_behind_the_camera_and_one_absurdly_near_are_not_believed():
    behind = seen_from(pose(0.3), (0.8, 0, 0))  # overtakes the camera: parallax of the wrong sign
    assert rigid_residual(K, np.eye(4), [behind]).error[BLOCK].min() > 1.0
    near = seen_from(pose(0.02), (-3.0, 0, 0))  # 50 px of motion over a baseline that gives the wall half a pixel
    assert rigid_residual(K, np.eye(4), [near]).error[BLOCK].min() > 10.0


def test_unknown_flow_has_no_weight_and_no_influence():
    good, bad = seen_from(pose(0.3)), seen_from(pose(-0.3))
    flow = bad.flow.copy()
    flow[:10], flow[10:20, :, 0], flow[20:30] = np.nan, np.inf, -np.inf
    both = [good, Neighbour(flow, bad.confidence, bad.K, bad.cam_from_world)]
    for residual in (rigid_residual(K, np.eye(4), both), uncalibrated_residual(both), epipolar_residual(both)):
        assert np.isfinite(residual.error).all() and residual.weight[:30].max() == 0.5
    assert rigid_residual(K, np.eye(4), both).error.max() < 2e-3


def test_rotation_is_a_homography_and_translation_is_not():
    grid = np.stack(np.meshgrid(np.arange(0, WIDTH, 5), np.arange(0, HEIGHT, 5)), -1).reshape(-1, 2)
    for camera, kind in ((pose(turn=0.05), "homography"), (pose(0.4, 0.1), "epipolar")):
        flow = seen_from(camera, noise=0.05).flow[grid[:, 1], grid[:, 0]]
        found = two_view(grid + 0.5, grid + 0.5 + flow)
        assert found is not None and found.kind == kind
        if kind == "epipolar":
            assert np.median(sampson(found.matrix, grid + 0.5, grid + 0.5 + flow)) < 0.05
    assert two_view(grid[:20], grid[:20]) is None  # too few
    two_view(np.zeros((50, 2)), np.zeros((50, 2)))  # all in one place: whatever it says, it does not fail


def test_wrong_input_is_named():
    good = seen_from(pose(0.3))
    with pytest.raises(ValueError, match="at least one"):
        rigid_residual(K, np.eye(4), [])
    with pytest.raises(ValueError, match=r"neighbours\[1\]: expected flow"):
        rigid_residual(K, np.eye(4), [good, Neighbour(good.flow[:8], good.confidence, K, np.eye(4))])
    with pytest.raises(ValueError, match=r"neighbours\[0\]: K and cam_from_world"):
        rigid_residual(K, np.eye(4), [Neighbour(good.flow, good.confidence)])
    with pytest.raises(ValueError, match=r"neighbours\[0\]: expected finite"):
        rigid_residual(K, np.eye(4), [Neighbour(good.flow, good.confidence, K, np.full((4, 4), np.nan))])
    with pytest.raises(ValueError, match="picture: expected uint8"):
        moving_mask(np.zeros((8, 8, 3), np.uint8), Evidence(np.zeros((9, 8), np.float32), np.ones((9, 8), np.float32), 0.1))


# --- noise and evidence


@pytest.mark.parametrize("sigma", [0.1, 0.5])
@pytest.mark.parametrize("moving", [0.0, 0.4])
def test_noise_is_measured_however_much_moves(sigma, moving):
    rng = np.random.default_rng(3)
    error = np.linalg.norm(rng.normal(0, sigma, (HEIGHT, WIDTH, 3)), axis=-1) / np.sqrt(2)  # two neighbours, three equations left over
    moves = np.zeros(error.shape, bool)
    moves[:, : int(moving * WIDTH)] = True
    error[moves] = 40 * sigma * rng.uniform(0.5, 2, np.count_nonzero(moves))
    residual = Residual(error.astype(np.float32), np.ones_like(error, np.float32))
    found = evidence(residual, np.zeros_like(residual.error))
    assert 0.8 * sigma < found.sigma < 1.6 * sigma
    assert (found.score[moves] > 0).all() and (found.score[~moves] < 0).all()


def test_a_rigid_moving_object_does_not_pass_for_the_noise():
    """Its pixels agree on their error far better than the static ones do, and in log they would be the higher peak."""
    rng = np.random.default_rng(4)
    error = np.exp(rng.normal(np.log(0.2), 0.8, (HEIGHT, WIDTH)))
    moves = np.zeros(error.shape, bool)
    moves[:, : round(0.35 * WIDTH)] = True
    error[moves] = 7 * np.exp(rng.normal(0, 0.1, np.count_nonzero(moves)))
    found = evidence(Residual(error.astype(np.float32), np.ones_like(error, np.float32)), np.zeros_like(error, np.float32))
    assert found.sigma < 0.5 and (found.score[moves] > 0).all() and (found.score[~moves] < 0).mean() > 0.95


def test_the_threshold_is_where_it_is_said_to_be():
    error = np.full((40, 40), 0.2, np.float32)
    error[0, :4] = 0.2 * NOISE_FACTOR * np.array([0.3, 0.9, 1.1, 3.3])
    found = evidence(Residual(error, np.ones_like(error)), np.zeros_like(error))
    assert found.sigma == pytest.approx(0.2, rel=0.05)
    assert found.score[0, 0] == -1 and -1 < found.score[0, 1] < 0 < found.score[0, 2] < 1 and found.score[0, 3] == 1


def test_too_few_pixels_are_no_evidence():
    error = np.full((5, 5), 9.0, np.float32)
    assert not evidence(Residual(error, np.ones_like(error)), error).weight.any()


@pytest.mark.parametrize("size", [8, 64])
@pytest.mark.parametrize("posed", [True, False])
def test_nothing_known_masks_nothing(size, posed):
    flow = np.random.default_rng(1).normal(0, 5, (size, size, 2)).astype(np.float32)
    picture = np.full((size, size, 3), 90, np.uint8)
    for field, confidence in ((flow, 0), (np.full_like(flow, np.nan), 255), (np.zeros_like(flow), 255)):
        one = Neighbour(field, np.full((size, size), confidence, np.uint8), K, np.eye(4))
        found = frame_evidence([one], *((K, np.eye(4)) if posed else ()))
        assert not moving_mask(picture, found).any()


def test_one_pair_of_a_fixed_camera_is_enough_for_what_moves_across():
    found = frame_evidence([seen_from(pose(), (0.3, 0, 0), 0.05)], K, np.eye(4))
    assert iou(moving_mask(np.where(BLOCK[..., None], 200, 50).astype(np.uint8).repeat(3, 2), found), BLOCK) > 0.9


def test_the_mask_follows_the_edges_of_the_picture_and_drops_specks():
    score = np.full((HEIGHT, WIDTH), -1.0, np.float32)
    score[cv2.dilate(BLOCK.astype(np.uint8), np.ones((9, 9))) > 0] = 1.0  # flow smears outlines by a few pixels ...
    weight = np.ones_like(score)
    weight[cv2.dilate(BLOCK.astype(np.uint8), np.ones((11, 11))) > 0] = 0.02  # ... and knows that it does
    weight[45:70, 65:95] = 1.0
    score[5:7, 5:7] = 1.0
    picture = np.where(BLOCK[..., None], 220, 40).astype(np.uint8).repeat(3, 2)
    mask = moving_mask(picture, Evidence(score, weight, 0.1))
    assert iou(mask, BLOCK) > 0.9 and not mask[:12, :12].any()


def test_spread_is_zero_in_even_flow_and_large_at_steps():
    even = np.full((40, 60, 2), 1000.0, np.float32)
    step = even.copy()
    step[:, 30:] += 4
    full = np.full((40, 60), 255, np.uint8)
    assert spread_of_flow([Neighbour(even, full)]).max() < 1e-2
    spread = spread_of_flow([Neighbour(step, full)])
    assert spread[20, 30] > 2 and spread[20, 2] < 1e-2


def test_chained_flow_adds_up_and_ends_at_the_border():
    first = np.full((20, 30, 2), (4, 1), np.float32), np.full((20, 30), 200, np.uint8)
    second = np.full((20, 30, 2), (3, -2), np.float32), np.full((20, 30), 100, np.uint8)
    flow, confidence = chain(first, second)
    assert np.allclose(flow, (7, -1)) and confidence[5, 5] == 100
    assert not confidence[:, 26:].any() and not confidence[19:].any()


# --- fixed cameras


def test_a_fixed_camera_shows_what_passes_in_each_frame():
    rng = np.random.default_rng(7)
    backdrop = cv2.resize(rng.integers(40, 200, (20, 25, 3), dtype=np.uint8), (100, 80), interpolation=cv2.INTER_CUBIC)
    frames, truths = [], []
    for k in range(9):
        frame, truth = backdrop.astype(float) + 2.0 * (k % 2), np.zeros((80, 100), bool)
        truth[30:50, 10 * k : 10 * k + 20] = True
        frame[truth] = (220, 30, 30)
        frames.append(np.clip(frame + rng.normal(0, 2, frame.shape), 0, 255).astype(np.uint8))
        truths.append(truth)
    masks = fixed_camera_masks(frames)
    assert min(iou(mask, truth) for mask, truth in zip(masks, truths)) > 0.7
    with pytest.raises(ValueError, match="frame: expected uint8"):
        FixedCameraMasks(frames).moving(frames[0][:10])
