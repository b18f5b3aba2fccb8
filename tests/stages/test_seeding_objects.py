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
    STANDS,
    THICKEST,
    _depth,
    _Told,
    depth_at,
    depth_below,
    object_depths,
)
from e4dgs.vision.flow.chain import Chain
from e4dgs.vision.moving.followed_parts import LEAST_AREA, Objects, follow_objects
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
    middle = [int(labels[HEIGHT // 2, WIDTH // 2]) for labels in objects.labels]
    corner = [int(labels[10, 10]) for labels in objects.labels]
    assert len({int(number[part]) for number, part in zip(objects.number, middle)}) == 1
    assert len({int(number[part]) for number, part in zip(objects.number, corner)}) == 1
    assert objects.number[0][middle[0]] != objects.number[0][corner[0]]
    for k in range(6):
        assert objects.log_size[k][middle[k]] == pytest.approx(k * np.log(GROWTH), abs=0.02)
        assert objects.log_size[k][corner[k]] == pytest.approx(0, abs=0.02)


def test_what_slides_keeps_its_number_and_size(tmp_path):
    objects = follow_objects(Chain(flow_of(tmp_path / "flow"), list(range(FRAMES))), FRAMES)
    assert [n.tolist() for n in objects.number] == [[-1, 0]] * FRAMES
    assert np.allclose([s[1] for s in objects.log_size], 0, atol=0.01)


def test_without_flow_each_frame_has_new_objects(tmp_path):
    objects = follow_objects(Chain(flow_of(tmp_path / "flow", gap=4), list(range(FRAMES))), FRAMES)
    assert [int(n[1]) for n in objects.number] == [0] * 5 + [1] * (FRAMES - 5)


@pytest.mark.parametrize(("area", "parts"), [(int(np.ceil(LEAST_AREA * WIDTH * HEIGHT)), 1), (int(LEAST_AREA * WIDTH * HEIGHT), 0)])
def test_specks_of_a_mask_are_no_objects(area, parts, tmp_path):
    flow = flow_of(tmp_path / "flow")
    chain = Chain(flow, [0])
    chain.small_mask = lambda k: (np.arange(WIDTH * HEIGHT) < area).reshape(HEIGHT, WIDTH)
    assert len(follow_objects(chain, 1).number[0]) == 1 + parts


def one_part(frames, log_size):
    labels = np.zeros((HEIGHT, WIDTH), np.uint8)
    labels[20:60, 60:100] = 1
    return Objects([labels] * frames, (1.0, 1.0), [np.array([-1, 0])] * frames, [np.array([0.0, s]) for s in log_size])


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
    told = _Told([(k, np.log(3.0)) for k in range(level)], [(0, np.log(8.0))], 4 - level)
    assert _depth(told, 0, 0.0) == pytest.approx(expected)


def test_frames_beside_count_by_themselves_where_they_tell_less():
    told = _Told([(k, np.log(4.0)) for k in range(9)] + [(30 + BESIDE, np.log(3.9))], [], 0)
    assert _depth(told, 30, 0.0) == pytest.approx(3.9) and _depth(told, 29, 0.0) == pytest.approx(4.0, rel=1e-3)


def test_a_surface_comes_nearer_within_the_outline_but_not_without_end():
    K = views().K[0].copy()
    middle = np.array([[80.0, 40.0]], np.float32)
    depths = np.array([0.0, 5.0])
    assert depth_at(one_part(1, [0.0]), depths, K, 0, middle, 1.0)[0] == pytest.approx(5 * (1 - 20 / K[0, 0]), rel=0.01)
    K[0, 0] = 30.0  # so wide a lens that the part would be as thick as it is far away
    assert depth_at(one_part(1, [0.0]), depths, K, 0, middle, 1.0)[0] == pytest.approx(5 * THICKEST)
    assert depth_at(one_part(1, [0.0]), np.zeros(2), K, 0, np.array([[5.0, 5.0]], np.float32), 7.0)[0] == pytest.approx(7.0)
