"""Flow chained from frame to frame, and how far away what moves is taken to be."""

import numpy as np
import pytest
from e4dgs.stages import mover_chain
from e4dgs.stages.mover_chain import Chain
from e4dgs.stages.mover_depths import BEFORE, FEWEST, component_depths
from moving_square import FRAMES, HEIGHT, WIDTH, flow_of, left_edge, views


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
