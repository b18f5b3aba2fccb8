"""Parts of masks that are one object over time, how their apparent size changes, and how far away they are taken to be."""

import numpy as np
import pytest
from e4dgs.pipeline import Artifact, ArtifactWriter
from e4dgs.stages.flow.artifact import StoredFlow
from e4dgs.stages.seeds.depths import (
    ANYWHERE,
    BEFORE,
    BESIDE,
    FEWEST,
    LOOKS,
    STANDS,
    THICKEST,
    TIGHTEST_CUT,
    _depth,
    _Told,
    depth_at,
    depth_below,
    object_depths,
    off_masks,
)
from e4dgs.vision.flow.chain import Chain
from e4dgs.vision.moving.attached_parts import bodies
from e4dgs.vision.moving.followed_objects import Objects, follow_objects
from e4dgs.vision.moving.object_labels import APART, LEAST_AREA, object_labels, parts
from moving_square import FRAMES, HEIGHT, WALL, WIDTH, flow_of, pose, views, wall

SIZE, GROWTH = 24, 1.08  # px of the square in the first frame, factor a frame


def growing(folder, frames=6, beside=True):
    """Flow and masks of a square that grows about the middle of the picture, and of one in a corner that keeps its size."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    masks = np.zeros((frames, HEIGHT, WIDTH), np.uint8)
    forward, backward = (np.zeros((frames - 1, HEIGHT, WIDTH, 2), np.float16) for _ in range(2))
    centre = np.array([(WIDTH - 1) / 2, (HEIGHT - 1) / 2])
    for k in range(frames):
        half = SIZE / 2 * GROWTH**k
        masks[k][(np.abs(x - centre[0]) < half) & (np.abs(y - centre[1]) < half)] = 255
        masks[k, 4:16, 4:16] = 255 * beside
    offset = np.stack([x, y], 2) - centre
    inside = (np.abs(offset) < SIZE).all(2)
    forward[:, inside] = ((GROWTH - 1) * offset)[inside]
    backward[:, inside] = ((1 / GROWTH - 1) * offset)[inside]
    folder.mkdir()
    out = ArtifactWriter(folder)
    out.write("pair", np.array([(k, k + 1) for k in range(frames - 1)], np.int32))
    out.write("forward", forward)
    out.write("backward", backward)
    out.write("confidence", np.full((frames - 1, HEIGHT, WIDTH), 255, np.uint8))
    out.write("moving", masks)
    out.finish({})
    return Chain(StoredFlow(Artifact(folder)), list(range(frames)))


def test_an_object_is_followed_and_its_size_measured(tmp_path):
    objects = follow_objects(growing(tmp_path / "flow"), 6)
    (middle,) = {int(labels[HEIGHT // 2, WIDTH // 2]) for labels in objects.labels}
    (corner,) = {int(labels[10, 10]) for labels in objects.labels}
    assert middle != corner and min(middle, corner) > 0
    for k in range(6):
        size = objects.log_size[k] - objects.log_size[0]
        assert size[middle] == pytest.approx(k * np.log(GROWTH), abs=0.02)
        assert size[corner] == pytest.approx(0, abs=0.02)


def test_what_slides_keeps_its_label_and_size(tmp_path):
    objects = follow_objects(Chain(flow_of(tmp_path / "flow"), list(range(FRAMES))), FRAMES)
    assert [np.unique(labels).tolist() for labels in objects.labels] == [[0, 1]] * FRAMES
    assert np.allclose(objects.log_size[:, 1], 0, atol=0.01) and not objects.body


def test_frames_in_which_nothing_moves_have_no_labels(tmp_path):
    chain = Chain(flow_of(tmp_path / "flow"), list(range(FRAMES)))
    shown = chain.small_mask
    chain.small_mask = lambda k: shown(k) & (k != 4)
    objects = follow_objects(chain, FRAMES)
    assert [int(labels.max()) for labels in objects.labels] == [1, 1, 1, 1, 0, 2, 2, 2, 2]


def test_without_flow_there_are_new_objects(tmp_path):
    objects = follow_objects(Chain(flow_of(tmp_path / "flow", gap=4), list(range(FRAMES))), FRAMES)
    assert [int(labels.max()) for labels in objects.labels] == [1] * 5 + [2] * (FRAMES - 5)


@pytest.mark.parametrize(("area", "count"), [(int(np.ceil(LEAST_AREA * WIDTH * HEIGHT)), 1), (int(LEAST_AREA * WIDTH * HEIGHT), 0)])
def test_specks_of_a_mask_are_no_objects(area, count):
    assert parts((np.arange(WIDTH * HEIGHT) < area).reshape(HEIGHT, WIDTH)).max() == count


class Still:
    """A `Chain` of masks (F times [h, w]) on which nothing moves from frame to frame but what is in ``steps``: px to the right by label of
    ``labels``."""

    def __init__(self, masks, labels=None, steps=None):
        self._masks, self._labels, self._steps = masks, labels, steps or {}
        self.height, self.width = masks[0].shape

    def small_mask(self, k):
        return self._masks[k]

    def move(self, k, direction, places):
        x, y = np.rint(places).astype(int).T
        moved = places.copy()
        if self._labels is not None:
            moved[:, 0] += [direction * self._steps.get(int(n), 0.0) for n in self._labels[k][y, x]]
        x, y = np.rint(moved).astype(int).T
        inside = (x >= 0) & (x < self.width) & (y >= 0) & (y < self.height)
        return moved, inside & self._masks[k + direction][np.clip(y, 0, self.height - 1), np.clip(x, 0, self.width - 1)]


def boxes(*spans):
    """A mask [40, 80] of boxes over columns ``spans``."""
    mask = np.zeros((40, 80), bool)
    for first, last in spans:
        mask[10:30, first:last] = True
    return mask


def test_two_whose_masks_touch_stay_two():
    chain = Still([boxes((10, 30), (40, 60)), boxes((10, 60)), boxes((10, 60)), boxes((10, 30), (40, 60))])
    labels = object_labels(chain, 4)
    assert all(one[20, 15] == 1 and one[20, 55] == 2 for one in labels)
    assert {int(n) for n in np.unique(labels[2])} == {0, 1, 2} and abs(int((labels[2] == 1).sum()) - int((labels[2] == 2).sum())) < 60


@pytest.mark.parametrize(("frames", "own"), [(APART - 1, False), (APART + 1, True)])
def test_what_leaves_a_mask_belongs_to_it_unless_it_stays_away(frames, own):
    labels = object_labels(Still([boxes((10, 60))] * 3 + [boxes((10, 40), (46, 60))] * frames), 3 + frames)
    assert labels[3][20, 55] == labels[3][20, 15] == 1
    assert bool(labels[-1][20, 55] == 2) is own and labels[-1][20, 15] == 1


@pytest.mark.parametrize(("step", "joined"), [(0.0, {2: 1}), (2.0, {})])
def test_what_moves_as_the_larger_object_that_it_touches_is_a_part_of_it(step, joined):
    labels = np.zeros((40, 80), np.uint8)
    labels[10:30, 10:50], labels[15:25, 50:62] = 1, 2
    chain = Still([np.ones((40, 80), bool)] * 6, [labels] * 6, {2: step})
    assert bodies(chain, [labels] * 6) == joined


def one_part(frames, log_size):
    labels = np.zeros((HEIGHT, WIDTH), np.uint8)
    labels[20:60, 60:100] = 1
    return Objects([labels] * frames, (1.0, 1.0), np.array([[0.0, s] for s in log_size]))


@pytest.mark.parametrize(("hidden", "known"), [(FEWEST, True), (FEWEST - 1, False)])
def test_a_depth_needs_a_few_hidden_points(hidden, known):
    points = np.tile([[0.0, -0.1, 5.0]], (hidden, 1))
    (depths,) = object_depths(one_part(1, [0.0]), views(), [0], np.concatenate([points, [[3.0, 0, 2.0], [0, 0, -5.0]]]))
    assert depths[0] == 0 and depths[1] == pytest.approx(BEFORE * 5.0 if known else 0.0)


def test_one_frame_tells_the_depth_of_all_by_the_size():
    points = np.tile([[0.0, -0.1, 5.0]], (FEWEST, 1)) - pose(0)[:3, 3]
    seen = views()
    seen.cam_from_world[1:, 0, 3] = 1e3  # nothing is before the other cameras
    depths = object_depths(one_part(3, [0.0, np.log(1.25), np.log(0.8)]), seen, [0, 1, 2], points)
    assert [d[1] for d in depths] == pytest.approx([BEFORE * 5, BEFORE * 5 / 1.25, BEFORE * 5 / 0.8])


def floor(height=1.0, count=4000):
    """Points of a level floor ``height`` below the camera, as pixels and depths."""
    rng = np.random.default_rng(0)
    points = np.stack([rng.uniform(-4, 4, count), np.full(count, height), rng.uniform(2, 8, count)], 1)
    return views().project(0, points)[1:]


def test_what_stands_on_a_floor_is_as_far_as_the_floor_at_its_feet():
    part = np.zeros((HEIGHT, WIDTH), bool)
    part[20:81, 70:90] = True
    K = views().K[0]
    expected = K[1, 1] * 1.0 / (80.5 - K[1, 2])  # of a point 1 below the camera in that row
    found = depth_below(part, K, *floor())
    assert found.level and found.depth == pytest.approx(expected, rel=0.02)


def test_nothing_stands_on_a_wall():
    part = np.zeros((HEIGHT, WIDTH), bool)
    part[20:60, 60:100] = True
    found = depth_below(part, views().K[0], *views().project(0, wall())[1:])
    assert not found.level and found.depth == pytest.approx(WALL, rel=0.01)
    (depths,) = object_depths(one_part(1, [0.0]), views(), [0], wall())
    assert depths[1] == pytest.approx(ANYWHERE * WALL, rel=1e-5)


@pytest.mark.parametrize(("level", "expected"), [(round(4 * STANDS), 3.0), (round(4 * STANDS) - 1, ANYWHERE * 8.0)])
def test_what_stands_has_a_floor_below_it_in_most_frames(level, expected):
    told = _Told([(k, np.log(3.0)) for k in range(level)], [], [], [(0, np.log(8.0))], list(range(4 - level)))
    assert _depth(told, 0, 0.0) == pytest.approx(expected)


def test_frames_beside_count_by_themselves_where_they_tell_less():
    told = _Told([(k, np.log(4.0)) for k in range(9)] + [(30 + BESIDE, np.log(3.9))], [], [], [], [])
    assert _depth(told, 30, 0.0) == pytest.approx(3.9) and _depth(told, 29, 0.0) == pytest.approx(4.0, rel=1e-3)


def test_a_surface_comes_nearer_within_the_outline_but_not_without_end():
    K = views().K[0].copy()
    middle = np.array([[80.0, 40.0]], np.float32)
    depths = np.array([0.0, 5.0])
    assert depth_at(one_part(1, [0.0]), depths, K, 0, middle, 1.0)[0] == pytest.approx(5 * (1 - 20 / K[0, 0]), rel=0.01)
    K[0, 0] = 30.0  # so wide a lens that the part would be as thick as it is far away
    assert depth_at(one_part(1, [0.0]), depths, K, 0, middle, 1.0)[0] == pytest.approx(5 * THICKEST)
    assert depth_at(one_part(1, [0.0]), np.zeros(2), K, 0, np.array([[5.0, 5.0]], np.float32), 7.0)[0] == pytest.approx(7.0)


def test_where_feet_are_cut_off_the_nearest_floor_counts():
    """Each frame's floor is that at the picture's edge, and so too far; the least of them is nearest to the truth."""
    values = [(k, np.log(4.0 + 0.1 * k)) for k in range(20)]
    assert _depth(_Told([], values, [], [], []), 15, 0.0) == pytest.approx(np.exp(np.percentile([v for _, v in values], TIGHTEST_CUT)))
    assert _depth(_Told(values, [], [], [], []), 15, 0.0) > 4.2


def test_an_arm_is_as_far_as_the_body_at_rest_that_it_joins():
    """Points of a body lie beside the part on its left, those of a wall on all sides and behind it."""
    rng = np.random.default_rng(0)
    body = views().K[0], rng.uniform(30, 58, 300), rng.uniform(20, 70, 300)
    K, x, y = body
    near = np.stack([(x - K[0, 2]) / K[0, 0] * 4.0, (y - K[1, 2]) / K[1, 1] * 4.0, np.full(300, 4.0)], 1)
    assert object_depths(one_part(3, [0.0] * 3), still(3), [0, 1, 2], np.concatenate([wall(), near]))[1][1] == pytest.approx(4.0, rel=0.01)
    alone = object_depths(one_part(3, [0.0] * 3), still(3), [0, 1, 2], wall())[1][1]
    assert alone == pytest.approx(ANYWHERE * WALL, rel=1e-3)


def still(frames):
    seen = views(frames)
    seen.cam_from_world[:] = pose(0)
    return seen


def test_points_that_masks_mostly_cover_are_not_static():
    points = np.array([[0.0, -0.1, 5.0], [-3.0, 0.0, 5.0]])
    for frames, kept in ((LOOKS, [False, True]), (LOOKS - 1, [True, True])):
        objects = one_part(frames, [0.0] * frames)
        assert off_masks(objects, still(frames), list(range(frames)), points).tolist() == kept


def test_a_part_follows_its_body():
    labels = np.zeros((HEIGHT, WIDTH), np.uint8)
    labels[20:60, 60:100], labels[20:40, 100:110] = 1, 2
    alone = np.where(labels == 1, 0, labels).astype(np.uint8)
    objects = Objects([labels, labels, alone], (1.0, 1.0), np.array([[0, 0, 0.0], [0, 0, 0.0], [0, 0, np.log(2.0)]]), {2: 1})
    depths = object_depths(objects, still(3), [0, 1, 2], wall())
    assert depths[0][2] == depths[0][1] > 0 and depths[2][2] == pytest.approx(depths[0][1] / 2, rel=1e-5)
