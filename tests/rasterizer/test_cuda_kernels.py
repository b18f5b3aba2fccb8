"""What holds for the CUDA kernels alone: determinism, any order of threads, many extras, sizes that are fixed beforehand, and refusals."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
import torch
from e4dgs.rasterizer import Frame, cuda_backend, rasterize
from e4dgs.rasterizer.cuda import capacity, selftest
from e4dgs.rasterizer.cuda import forward as passes
from e4dgs.rasterizer.cuda.forward import forward
from e4dgs.rasterizer.cuda.runtime import launching
from simt import CHECKED, RACES, Emulator
from simt.compiler import needs_compiler

from .compare import OUTPUTS, assert_gradients_close, cotangents, decided_by_threshold, gradients
from .kernels import GPU, on_the_gpu
from .scenes import Scene, one_convex, prism, random_scene

EVERYTHING = {"gaussians": 40, "convexes": 20, "degree": 2, "extras": 2, "width": 45, "height": 37}


@contextmanager
def deterministic() -> Iterator[None]:
    torch.use_deterministic_algorithms(True)
    try:
        yield
    finally:
        torch.use_deterministic_algorithms(False)


def everything(scene: Scene, weights: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """All images and all gradients."""
    frame = scene.render("cuda")
    return {name: getattr(frame, name) for name in (*OUTPUTS, "visible_gaussians", "visible_convexes")} | gradients(scene, "cuda", weights)


def some_scene(**changes: Any) -> tuple[Scene, dict[str, torch.Tensor]]:
    scene = random_scene(3, **{**EVERYTHING, **changes}).to(torch.float32)
    want = scene.render("reference")
    return scene, cotangents(want, ignore=decided_by_threshold(scene))


@needs_compiler
def test_deterministic_sums_do_not_depend_on_the_order_of_blocks_and_threads() -> None:
    """Bit-equal whatever runs first; a missing barrier would show too."""
    scene, weights = some_scene()
    with deterministic():
        runs = []
        for seed in range(4):
            with launching("cpu", Emulator(seed)):
                runs.append(everything(scene, weights))
    for run in runs[1:]:
        for name, value in run.items():
            assert torch.equal(value, runs[0][name]), name
    # And they are right: the default order gives the same numbers, to rounding.
    with launching("cpu", Emulator()):
        usual = everything(scene, weights)
    assert_gradients_close(usual, {name: value.double() for name, value in runs[0].items()}, relative=1e-5)


@pytest.mark.cuda
def test_deterministic_sums_are_bit_equal_over_ten_runs_on_a_gpu() -> None:
    scene, weights = some_scene(gaussians=400, convexes=200, width=200, height=120)
    with deterministic(), on_the_gpu():
        runs = [everything(scene, weights) for _ in range(10)]
    for run in runs[1:]:
        for name, value in run.items():
            assert torch.equal(value, runs[0][name]), name


@needs_compiler
def test_no_access_is_out_of_bounds_and_no_two_are_unordered() -> None:
    """Bounds of arrays, alignment, overflow of integers; then accesses to shared and global memory that no barrier orders."""
    scene, weights = some_scene(gaussians=12, convexes=6, width=33, height=17)
    for mode in (False, True):
        torch.use_deterministic_algorithms(mode)
        try:
            with launching("cpu", Emulator(seed=1, flags=(*CHECKED, *RACES))):
                everything(scene, weights)
        finally:
            torch.use_deterministic_algorithms(False)


@needs_compiler
@pytest.mark.parametrize("extras", [9, 19])
def test_more_extras_than_a_launch_takes(extras: int) -> None:
    scene, weights = some_scene(gaussians=20, convexes=8, extras=extras, degree=None)
    want = gradients(scene, "reference", weights)
    with launching("cpu", Emulator()):
        frame = scene.render("cuda")
        got = gradients(scene, "cuda", weights)
        with deterministic():
            fixed = gradients(scene, "cuda", weights)
    reference = scene.render("reference")
    keep = ~decided_by_threshold(scene)
    assert float((frame.extras - reference.extras).abs()[keep].max()) < 2e-5
    assert_gradients_close(got, want)
    assert_gradients_close(fixed, want)


@needs_compiler
def test_a_tile_s_list_of_several_batches() -> None:
    """More primitives on one tile than blending takes at a time (128), so that batches hand over to one another both ways."""
    scene, weights = some_scene(gaussians=300, convexes=70, degree=0, extras=None, size=0.05, spread=0.15, width=20, height=20)
    assert scene.gaussians is not None and scene.convexes is not None
    scene = scene.having({"gaussians.opacities": scene.gaussians.opacities * 0.1, "convexes.opacities": scene.convexes.opacities * 0.1})
    want = scene.render("reference")
    weights = cotangents(want, ignore=decided_by_threshold(scene))
    with launching("cpu", Emulator()):
        got = gradients(scene, "cuda", weights)
    assert_gradients_close(got, gradients(scene, "reference", weights))


@needs_compiler
def test_room_for_more_pairs_than_there_are_changes_nothing_and_for_fewer_drops_the_furthest(monkeypatch: pytest.MonkeyPatch) -> None:
    """Inside a CUDA graph the number of pairs is fixed beforehand (`capacity.room_in_graph`)."""
    scene, weights = some_scene(convexes=0, extras=None)
    taken: list[int] = []
    monkeypatch.setattr(capacity, "took", lambda inputs, pairs: taken.append(pairs))
    monkeypatch.setattr(capacity, "likely_room", lambda inputs: None)
    with launching("cpu", Emulator()):
        exact, exact_gradients = scene.render("cuda"), gradients(scene, "cuda", weights)
        monkeypatch.setattr(capacity, "room_in_graph", lambda inputs: taken[0] + 777)
        roomy, roomy_gradients = scene.render("cuda"), gradients(scene, "cuda", weights)
        monkeypatch.setattr(capacity, "room_in_graph", lambda inputs: taken[0] // 2)
        short = scene.render("cuda")
        with deterministic():
            gradients(scene, "cuda", weights)
    assert all(torch.equal(getattr(exact, name), getattr(roomy, name)) for name in OUTPUTS)
    assert all(torch.equal(value, roomy_gradients[name]) for name, value in exact_gradients.items())
    assert 0 < int(short.visible_gaussians.sum()) < int(exact.visible_gaussians.sum())
    assert len(taken) >= 2 and len(set(taken)) == 1, "frames inside a capture are no measure for others"


@needs_compiler
@pytest.mark.parametrize("likely", [0, 1, 10_000], ids=["no room", "room for one", "more than enough"])
def test_a_frame_that_takes_more_than_the_last_ones_is_made_again(monkeypatch: pytest.MonkeyPatch, likely: int) -> None:
    scene, weights = some_scene()
    taken: list[int] = []
    with launching("cpu", Emulator()):
        monkeypatch.setattr(capacity, "likely_room", lambda inputs: None)
        exact, exact_gradients = scene.render("cuda"), gradients(scene, "cuda", weights)
        monkeypatch.setattr(capacity, "likely_room", lambda inputs: likely)
        monkeypatch.setattr(capacity, "took", lambda inputs, pairs: taken.append(pairs))
        guessed, guessed_gradients = scene.render("cuda"), gradients(scene, "cuda", weights)
    assert 1 < taken[0] < 10_000 and len(set(taken)) == 1
    assert all(torch.equal(getattr(exact, name), getattr(guessed, name)) for name in OUTPUTS)
    assert all(torch.equal(value, guessed_gradients[name]) for name, value in exact_gradients.items())


def test_room_follows_the_last_frames_and_never_forgets_the_largest() -> None:
    class Inputs:
        device, width, height = torch.device("cpu"), 4321, 76

    assert capacity.likely_room(Inputs()) is None  # type: ignore[arg-type]
    for pairs, room in ((1000, 1250 + 1024), (10, 1225 + 1024), (2000, 2500 + 1024)):
        capacity.took(Inputs(), pairs)  # type: ignore[arg-type]
        assert capacity.likely_room(Inputs()) == room  # type: ignore[arg-type]


def test_a_capture_without_a_frame_before_it_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    class Inputs:
        device, width, height = torch.device("cuda", 0), 12345, 67

    monkeypatch.setattr(torch.cuda, "is_current_stream_capturing", lambda: True)
    with pytest.raises(RuntimeError, match=r"no frame of 12345 x 67 was rendered on cuda:0 before: render one first"):
        capacity.room_in_graph(Inputs())  # type: ignore[arg-type]
    capacity.took(Inputs(), 1000)  # type: ignore[arg-type]
    capacity.took(Inputs(), 10)  # type: ignore[arg-type]
    assert capacity.room_in_graph(Inputs()) == 1470 + 1024  # type: ignore[arg-type]
    monkeypatch.setattr(torch.cuda, "is_current_stream_capturing", lambda: False)
    assert capacity.room_in_graph(Inputs()) is None  # type: ignore[arg-type]


def test_out_of_memory_names_what_to_lower_and_the_next_frame_is_fine(monkeypatch: pytest.MonkeyPatch) -> None:
    scene, _ = some_scene(extras=None)

    def full(*_: object) -> None:
        raise torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 20.00 GiB")

    with launching("cpu", Emulator()):
        monkeypatch.setattr(cuda_backend, "forward", full)
        with pytest.raises(
            torch.OutOfMemoryError, match=r"40 Gaussians and 20 convexes at 45 x 37; render a smaller image, fewer.*20.00 GiB"
        ):
            scene.render("cuda")
        monkeypatch.setattr(cuda_backend, "forward", forward)
        assert isinstance(scene.render("cuda"), Frame)


@needs_compiler
def test_more_pairs_than_can_be_numbered_are_refused_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = one_convex(prism([[-0.5, -0.4], [0.5, -0.4], [0.5, 0.4], [-0.5, 0.4]]), width=64, height=64).to(torch.float32)
    with launching("cpu", Emulator()):
        monkeypatch.setattr(passes, "MOST_PAIRS", 3)
        with pytest.raises(
            MemoryError, match=r"1 primitives cover .* pairs of a tile and a primitive in this 64 x 64 image, more than the 3"
        ):
            scene.render("cuda")


@needs_compiler
def test_gradients_are_made_only_of_what_is_asked_for() -> None:
    scene, weights = some_scene()
    whole = {}
    with launching("cpu", Emulator()):
        whole = gradients(scene, "cuda", weights)
        for name in ("K", "background", "gaussians.sh", "convexes.points", "convexes.extras"):
            leaf = scene.tensors()[name].clone().requires_grad_()
            frame = scene.having({name: leaf}).render("cuda")
            loss = sum((getattr(frame, output) * weight).sum() for output, weight in weights.items())
            (alone,) = torch.autograd.grad(loss, leaf)  # type: ignore[arg-type]
            assert torch.equal(alone, whole[name]), name


@needs_compiler
def test_the_selftest_agrees_and_notices_what_is_wrong(monkeypatch: pytest.MonkeyPatch) -> None:
    with launching("cpu", Emulator()):
        assert selftest.problem("cpu") is None
        right = cuda_backend.backward
        monkeypatch.setattr(cuda_backend, "backward", lambda *given: {name: 1.002 * value for name, value in right(*given).items()})
        assert re.search(r"compute something else.*: the gradient of \S+ is off by 2.0e-03", selftest.problem("cpu") or "")
    assert "do not run here: ValueError" in (selftest.problem("cpu") or "")


@pytest.mark.cuda
def test_a_captured_graph_renders_what_changed_inputs_ask_for() -> None:
    scene, _ = some_scene(extras=None)
    there = Scene(*(getattr(scene, part) for part in ("camera", "gaussians", "convexes", "background")))
    there = there.having({name: value.cuda() for name, value in there.tensors().items()})
    with torch.no_grad():
        there.render(GPU)
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph):
            frame = there.render(GPU)
        assert there.gaussians is not None
        there.gaussians.means.add_(0.05)
        graph.replay()
        torch.cuda.synchronize()
        fresh = rasterize(there.camera, there.gaussians, there.convexes, there.background, backend="cuda")
    assert torch.equal(frame.color, fresh.color)


@needs_compiler
@pytest.mark.parametrize(
    "wanted", [("gaussians.extras", "convexes.extras"), ("convexes.points",), ("gaussians.means",), ("K", "gaussians.extras")]
)
def test_what_is_not_wanted_is_not_computed_and_changes_nothing(wanted: tuple[str, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    """Probes and flow want the extras' gradients alone: nothing is then projected back."""
    scene, weights = some_scene()
    launched = []

    class Noting(Emulator):
        def launch(self, program: Any, kernel: str, *arguments: Any) -> None:
            launched.append(kernel)
            super().launch(program, kernel, *arguments)

    with launching("cpu", Noting()):
        every = gradients(scene, "cuda", weights)
        launched.clear()
        leaves = {name: scene.tensors()[name].detach().clone().requires_grad_() for name in wanted}
        frame = scene.having(leaves).render("cuda")
        loss = sum((getattr(frame, name) * weight).sum() for name, weight in weights.items())
        found = torch.autograd.grad(loss, list(leaves.values()))
    for name, gradient in zip(leaves, found):
        assert torch.equal(gradient, every[name]), name
    kinds = {"gaussians": "gaussians.means" in wanted or "K" in wanted, "convexes": "convexes.points" in wanted or "K" in wanted}
    assert {kind: f"backproject_{kind}" in launched for kind in kinds} == kinds
