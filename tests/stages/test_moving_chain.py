"""Flow chained from frame to frame."""

import numpy as np
import pytest
from e4dgs.vision.flow import chain as moving_chain
from e4dgs.vision.flow.chain import Chain
from moving_square import FRAMES, WIDTH, flow_of, left_edge


@pytest.mark.parametrize("size", [480, WIDTH // 2])
def test_a_track_ends_where_the_mask_does(size, tmp_path, monkeypatch):
    monkeypatch.setattr(moving_chain, "SIZE", size)
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
