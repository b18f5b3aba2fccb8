"""The same bits from any number of threads and from run to run: image and all gradients."""

import pytest
import torch
from rasterizer.compare import OUTPUTS, cotangents, gradients
from rasterizer.kernels import needs_cpu
from rasterizer.scenes import Scene, random_scene
from torch import Tensor

pytestmark = needs_cpu

RUNS = (1, 2, 4, 1, 2, 4, 4, 2, 4, 2)  # threads
# Enough primitives that every stage has several blocks of work, and ranges of the order that depend on the number of threads.
SCENES = {
    "gaussians": {"gaussians": 2500},
    "convexes": {"convexes": 1500},
    "mix": {"gaussians": 1500, "convexes": 700},
    "mix, antialiased": {"gaussians": 1500, "convexes": 700, "antialiased": True},
}


def results(scene: Scene, weights: dict[str, Tensor]) -> dict[str, Tensor]:
    frame = scene.render("cpu")
    return {name: getattr(frame, name) for name in (*OUTPUTS, "visible_gaussians", "visible_convexes")} | gradients(scene, "cpu", weights)


@pytest.mark.parametrize("options", SCENES.values(), ids=SCENES.keys())
def test_ten_runs_with_1_2_and_4_threads_are_bit_equal(instruction_set: str, options: dict) -> None:  # type: ignore[type-arg]
    scene = random_scene(70, degree=2, extras=2, width=70, height=52, size=0.15, **options).to(torch.float32)
    weights = cotangents(scene.render("cpu"))
    torch.set_num_threads(RUNS[0])
    first = results(scene, weights)
    assert all(bool(first[name].any()) for name in first if name != "visible_gaussians" and name != "visible_convexes")
    for run, threads in enumerate(RUNS[1:]):
        torch.set_num_threads(threads)  # the fixture puts it back
        again = results(scene, weights)
        for name, value in first.items():
            assert torch.equal(again[name], value), f"{name}, run {run + 1} with {threads} threads"


def test_equal_depths_keep_their_order_with_any_number_of_threads() -> None:
    """2000 primitives on four planes: ties are decided by the input's order, not by who came first."""
    scene = random_scene(71, gaussians=1300, convexes=700, degree=None, width=50, height=40, size=0.2)
    pose = torch.eye(4, dtype=torch.float64)
    pose[2, 3] = 4.0
    tensors = scene.tensors()
    for name in ("gaussians.means", "convexes.points"):
        tensors[name][..., 2] = (tensors[name][..., 2] * 2).round() / 2
    tensors["convexes.points"][..., 2] = tensors["convexes.points"][:, :1, 2]
    single = scene.having({**tensors, "cam_from_world": pose}).to(torch.float32)
    images = []
    for threads in (1, 2, 4):
        torch.set_num_threads(threads)
        images.append(single.render("cpu").color)
    assert torch.equal(images[0], images[1]) and torch.equal(images[0], images[2])
    want = single.render("reference").color
    assert float((images[0] - want).abs().mean()) < 1e-5
