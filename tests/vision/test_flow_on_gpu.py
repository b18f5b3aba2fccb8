"""What Kornia computes of flow on a GPU, held against what OpenCV and numpy compute on the CPU: here on the CPU, and on a pretended GPU."""

import cv2
import numpy as np
import pytest
from e4dgs.vision import edges, warp
from e4dgs.vision.edges import motion_boundaries, seen_by
from e4dgs.vision.flow import on_gpu
from e4dgs.vision.flow.two_way import consistency
from pretend_cuda import pretending_cuda

H, W = 70, 90


@pytest.fixture(scope="module")
def flows() -> tuple[np.ndarray, np.ndarray]:
    """A square that moves by (6, -3) px over ground that moves by (1.5, 0.25) px, there and back, with errors of measurement."""
    rng = np.random.default_rng(0)
    forward, backward = (np.empty((H, W, 2), np.float32) for _ in range(2))
    forward[:], backward[:] = (1.5, 0.25), (-1.5, -0.25)
    forward[20:50, 30:60], backward[17:47, 36:66] = (6, -3), (-6, 3)
    errors = [cv2.GaussianBlur(1.5 * rng.normal(size=(H, W, 2)).astype(np.float32), (0, 0), 2.0) for _ in range(2)]
    return forward + errors[0], backward + errors[1]


@pytest.fixture(scope="module")
def picture() -> np.ndarray:
    y, x = np.mgrid[:H, :W]
    return (127.5 + 60 * np.sin(x / 5) + 60 * np.cos(y / 7)).astype(np.uint8)


def close(found: np.ndarray, expected: np.ndarray, most: float, mean: float) -> None:
    """The largest and the mean difference. OpenCV rounds places to 1/32 px, which matters most across the outline of the square."""
    difference = np.abs(found.astype(np.float64) - expected)
    assert found.dtype == expected.dtype and found.shape == expected.shape
    assert difference.max() <= most and difference.mean() <= mean, (difference.max(), difference.mean())


@pytest.fixture(params=["cpu", "cuda"])
def device(request):
    if request.param == "cpu":
        yield "cpu"
        return
    with pretending_cuda():
        yield "cuda"


def sampled_by_kornia(values, flow, device):
    """`warp.sampled` on a device whose name it does not take for the CPU."""
    return warp.warped(values, flow, "cpu:0" if device == "cpu" else device)


def test_warps(flows, picture, device):
    close(sampled_by_kornia(picture, flows[0], device), warp.warped(picture, flows[0]), 1, 0.2)
    close(sampled_by_kornia(flows[1], flows[0], device), warp.warped(flows[1], flows[0]), 0.3, 0.005)
    half = np.concatenate([flows[0][..., :1] + 0.5, flows[0][..., 1:]], axis=2)
    assert np.abs(sampled_by_kornia(picture, half, device) - warp.warped(picture, flows[0]).astype(float)).mean() > 1, "half a px is seen"


def test_consistency(flows, device):
    found, expected = on_gpu.consistency(*flows, device), consistency(*flows)
    close(found, expected, 60, 0.3)
    assert 0.1 < (expected == 0).mean() < 0.5 and ((found == 0) == (expected == 0)).mean() > 0.995


def test_motion_boundaries(flows, device):
    confidence = consistency(*flows)
    close(on_gpu.motion_boundaries(flows[0], confidence, edges.BOUNDARY, device), motion_boundaries(flows[0], confidence), 1, 0.01)
    assert (motion_boundaries(flows[0], confidence) > 200).sum() > 50


def test_flow_that_is_not_finite_is_neither_consistent_nor_a_boundary(flows, device):
    forward = flows[0].copy()
    forward[30:40, 40:50] = np.nan
    assert not on_gpu.consistency(forward, flows[1], device)[30:40, 40:50].any()
    assert not on_gpu.motion_boundaries(forward, np.full((H, W), 255, np.uint8), edges.BOUNDARY, device)[32:38, 42:48].any()


def test_a_device_chooses_kornia(flows, picture, monkeypatch):
    """Arguments reach the GPU's functions as the stage gives them."""
    seen = []
    monkeypatch.setattr(on_gpu, "consistency", lambda *given: seen.append(given[-1]))
    monkeypatch.setattr(on_gpu, "motion_boundaries", lambda *given: seen.append(given[-1]))
    with pretending_cuda():
        consistency(*flows, device="cuda")
        one = seen_by(picture, flows[0], np.full((H, W), 255, np.uint8), device="cuda")
    assert seen == ["cuda", "cuda"]
    close(one.weight, warp.warped(picture, flows[0]), 1, 0.2)
