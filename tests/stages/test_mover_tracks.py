"""Tracks of what moves before a moving camera: where they lead, how far away they are taken to be, and what ends them."""

import numpy as np
import pytest
from e4dgs.stages import mover_chain
from e4dgs.stages.mover_chain import Chain
from e4dgs.stages.mover_depths import BEFORE, FEWEST, component_depths
from e4dgs.stages.mover_tracks import mover_tracks
from moving_square import FOCAL, FRAMES, HEIGHT, WALL, WIDTH, flow_of, left_edge, pose, views, wall


def test_tracks_follow_what_moves_at_the_depth_of_what_it_hides(tmp_path):
    tracks, seen = mover_tracks(flow_of(tmp_path / "flow"), views(), wall()), views()
    assert tracks is not None and len(tracks.rest) > 300
    assert tracks.alive.mean() > 0.9, "the square is in sight all the time"
    assert np.array_equal(tracks.rest, tracks.positions[FRAMES // 2]), "all tracks reach the middle"
    for k in range(FRAMES):
        cam = tracks.positions[k, tracks.alive[k]] + pose(k)[:3, 3]
        assert np.allclose(cam[:, 2], BEFORE * WALL, rtol=1e-5)
        x = FOCAL * cam[:, 0] / cam[:, 2] + WIDTH / 2 - left_edge(k)
        assert x.min() > -1 and x.max() < 41
    assert np.allclose(tracks.colors, (10 * (FRAMES // 2) + 5) / 255), "colours are those of the frame in which a track begins"
    assert np.array_equal(tracks.times, seen.time)


def test_where_flow_was_not_measured_tracks_end_and_later_ones_are_carried_home(tmp_path):
    tracks = mover_tracks(flow_of(tmp_path / "flow", gap=6), views(), wall())
    assert tracks is not None
    late = tracks.alive[7] & ~tracks.alive[4]
    assert late.sum() > 100 and not (tracks.alive[6] & tracks.alive[7]).any()
    # Nothing reaches over the gap, so nothing says where the late ones rest: they stay where they were seen first.
    assert np.allclose(tracks.rest[late], tracks.positions[np.argmax(tracks.alive[:, late], 0), np.flatnonzero(late)], atol=1.0)


def test_nothing_that_moves_or_nothing_hidden_has_no_tracks(tmp_path):
    flow = flow_of(tmp_path / "flow")
    assert mover_tracks(flow, views(), np.zeros((0, 3))) is None
    assert mover_tracks(flow, views(2), wall()) is None, "two frames are no path"


def test_advance_counts_every_frame_once(tmp_path):
    done: list[int] = []
    mover_tracks(flow_of(tmp_path / "flow"), views(), wall(), done.append)
    assert sum(done) == FRAMES


@pytest.mark.parametrize(("hidden", "known"), [(FEWEST, True), (FEWEST - 1, False)])
def test_a_depth_needs_a_few_hidden_points(hidden, known):
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[20:60, 60:100] = True
    points = np.tile([[0.0, -0.1, 5.0]], (hidden, 1))
    labels, depths = component_depths(mask, views(), 0, np.concatenate([points, [[3.0, 0, 2.0], [0, 0, -5.0]]]))
    assert labels[40, 80] == 1 and depths[0] == 0
    assert depths[1] == pytest.approx(BEFORE * 5.0 if known else 0.0)


@pytest.mark.parametrize("size", [480, WIDTH // 2])
def test_a_track_ends_where_the_mask_does(size, tmp_path, monkeypatch):
    monkeypatch.setattr(mover_chain, "SIZE", size)
    flow = flow_of(tmp_path / "flow")
    chain = Chain(flow, list(range(FRAMES)))
    inside, outside = left_edge(0) + 20, left_edge(0) - 20
    places, alive = chain.follow(0, np.array([[inside, 50.0], [outside, 50.0]], np.float32))
    assert alive[:, 0].all() and alive[0, 1] and not alive[1:, 1].any()
    assert places[-1, 0] == pytest.approx([left_edge(FRAMES - 1) + 20, 50.0], abs=0.01)


def test_chain_reads_only_pairs_of_neighbours(tmp_path):
    chain = Chain(flow_of(tmp_path / "flow"), [0, 2, 4])
    _, alive = chain.follow(1, np.array([[100.0, 50.0]], np.float32))
    assert alive.tolist() == [[False], [True], [False]]
