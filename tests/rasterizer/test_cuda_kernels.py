"""What holds for the CUDA kernels alone: determinism, any order of threads, many extras, sizes that are fixed beforehand, and refusals."""

import re
from typing import Any

import pytest
import torch
from deterministic import deterministic
from e4dgs.rasterizer import Frame, cuda_backend, rasterize
from e4dgs.rasterizer.cuda import capacity, selftest, state
from e4dgs.rasterizer.cuda import forward as passes
from e4dgs.rasterizer.cuda.capacity import Room
from e4dgs.rasterizer.cuda.forward import forward
from e4dgs.rasterizer.cuda.runtime import launching
from simt import CHECKED, RACES, Emulator
from simt.compiler import needs_compiler

from .compare import OUTPUTS, assert_gradients_close, cotangents, decided_by_threshold, gradients
from .kernels import GPU, on_the_gpu
from .scenes import Scene, one_convex, prism, random_scene

EVERYTHING = {"gaussians": 40, "convexes": 20, "degree": 2, "extras": 2, "width": 45, "height": 37}


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
@pytest.mark.parametrize("length", [1.0, 1e3, 1e6, 1e12, 1e30])
def test_the_tiles_of_a_slanted_needle_hold_all_of_it(length: float) -> None:
    """Their limits are computed in float, where a long needle's are differences of large numbers. The centre lies beside the picture."""
    for k in range(8):
        scene = random_scene(k, gaussians=1, degree=None, width=90, height=70)
        gaussians = scene.gaussians
        assert gaussians is not None
        gaussians.opacities[:], gaussians.means[:] = 0.5, 0.3 * (k - 3.5)
        gaussians.scales[:] = torch.tensor([length, 1e-3, 1e-3])
        scene.antialiased = k % 2 == 1
        single = scene.to(torch.float32)
        with launching("cpu", Emulator()):
            got = single.render("cuda")
        want, decided = single.render("reference"), decided_by_threshold(single)
        assert torch.equal((got.alpha > 0)[~decided], (want.alpha > 0)[~decided]), k


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
    taken: list[Room] = []
    monkeypatch.setattr(capacity, "took", lambda inputs, used: taken.append(used))
    monkeypatch.setattr(capacity, "likely_room", lambda inputs: None)
    with launching("cpu", Emulator()):
        exact, exact_gradients = scene.render("cuda"), gradients(scene, "cuda", weights)
        monkeypatch.setattr(capacity, "room_in_graph", lambda inputs: Room(inputs.n, inputs.m, taken[0].pairs + 777))
        roomy, roomy_gradients = scene.render("cuda"), gradients(scene, "cuda", weights)
        monkeypatch.setattr(capacity, "room_in_graph", lambda inputs: Room(inputs.n, inputs.m, taken[0].pairs // 2))
        short = scene.render("cuda")
        with deterministic():
            gradients(scene, "cuda", weights)
    assert all(torch.equal(getattr(exact, name), getattr(roomy, name)) for name in OUTPUTS)
    assert all(torch.equal(value, roomy_gradients[name]) for name, value in exact_gradients.items())
    assert 0 < int(short.visible_gaussians.sum()) < int(exact.visible_gaussians.sum())
    assert len(taken) >= 2 and len(set(taken)) == 1, "frames inside a capture are no measure for others"


@needs_compiler
def test_in_a_graph_room_for_fewer_primitives_leaves_out_the_last_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    scene, weights = some_scene()
    assert scene.gaussians is not None and scene.convexes is not None
    first = Room(7, 3, 10_000)
    monkeypatch.setattr(capacity, "room_in_graph", lambda inputs: first)
    with launching("cpu", Emulator(flags=CHECKED)):
        short, found = scene.render("cuda"), gradients(scene, "cuda", weights)
        with deterministic():
            gradients(scene, "cuda", weights)
    seen_gaussians, seen_convexes = (int(visible.nonzero().max()) + 1 for visible in (short.visible_gaussians, short.visible_convexes))
    assert 7 <= seen_gaussians < 40 and 3 <= seen_convexes < 20
    few = {f"gaussians.{name}": value[:seen_gaussians] for name, value in vars(scene.gaussians).items() if value is not None}
    few |= {f"convexes.{name}": value[:seen_convexes] for name, value in vars(scene.convexes).items() if value is not None}
    alone = scene.having(few)
    with launching("cpu", Emulator()):
        want, wanted = alone.render("cuda"), gradients(alone, "cuda", weights)
    assert all(torch.equal(getattr(short, name), getattr(want, name)) for name in OUTPUTS)
    for name, value in wanted.items():
        if "." in name:
            assert torch.equal(found[name][: len(value)], value) and not found[name][len(value) :].any(), name


@needs_compiler
@pytest.mark.parametrize(
    "likely",
    [Room(0, 0, 0), Room(40, 20, 1), Room(5, 20, 10_000), Room(40, 2, 10_000), Room(40, 20, 10_000)],
    ids=["no room", "for one pair", "for few Gaussians", "for few convexes", "more than enough"],
)
def test_a_frame_that_takes_more_than_the_last_ones_is_made_again(monkeypatch: pytest.MonkeyPatch, likely: Room) -> None:
    scene, weights = some_scene()
    taken: list[Room] = []
    with launching("cpu", Emulator()):
        monkeypatch.setattr(capacity, "likely_room", lambda inputs: None)
        exact, exact_gradients = scene.render("cuda"), gradients(scene, "cuda", weights)
        monkeypatch.setattr(capacity, "likely_room", lambda inputs: likely)
        monkeypatch.setattr(capacity, "took", lambda inputs, used: taken.append(used))
        guessed, guessed_gradients = scene.render("cuda"), gradients(scene, "cuda", weights)
    assert 1 < taken[0].pairs < 10_000 and len(set(taken)) == 1
    assert all(torch.equal(getattr(exact, name), getattr(guessed, name)) for name in OUTPUTS)
    assert all(torch.equal(value, guessed_gradients[name]) for name, value in exact_gradients.items())


@needs_compiler
def test_what_the_view_does_not_show_is_not_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """A frame takes the memory of what it shows, from the second frame of a size on, and culled primitives change nothing."""
    scene, weights = some_scene(convexes=0, extras=None)
    assert scene.gaussians is not None
    behind = {f"gaussians.{name}": torch.cat([v, v, v]) for name, v in vars(scene.gaussians).items() if v is not None}
    away = scene.gaussians.means + torch.tensor([1e4, 0.0, 0.0])
    crowd = scene.having(behind | {"gaussians.means": torch.cat([away, scene.gaussians.means, away])})
    monkeypatch.setattr(capacity, "_TAKEN", {})
    monkeypatch.setattr(capacity, "LIKELY_ROOM", 0)
    states = []

    def noting(*given: Any) -> Any:
        images, state = forward(*given)
        states.append(state)
        return images, state

    monkeypatch.setattr(cuda_backend, "forward", noting)
    with launching("cpu", Emulator()):
        alone, wanted = scene.render("cuda"), gradients(scene, "cuda", weights)
        shown = int((states[-1].slots >= 0).sum())
        frame, found = crowd.render("cuda"), gradients(crowd, "cuda", weights)
    assert 0 < shown <= 40 and len(states[-1].ids) == len(states[-1].gaussians) <= 1.1 * shown
    assert (states[-1].slots >= 0).nonzero().flatten().tolist() == (states[-1].ids[:shown]).tolist()
    assert all(torch.equal(getattr(frame, name), getattr(alone, name)) for name in OUTPUTS)
    for name, value in wanted.items():
        if "." in name:
            assert torch.equal(found[name][40:80], value) and not found[name][:40].any() and not found[name][80:].any(), name


class SomeInputs:
    n, m, width, height = 100, 7, 4321, 76

    def __init__(self, device: str) -> None:
        self.device = torch.device(device)


def test_room_follows_the_last_frames_and_never_forgets_the_largest(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(capacity, "_TAKEN", {})
    inputs: Any = SomeInputs("cpu")
    assert capacity.likely_room(inputs) is None
    monkeypatch.setattr(capacity, "LIKELY_ROOM", 1)
    for pairs, room in ((1000, 1250), (10, 1225), (2000, 2500)):
        capacity.took(inputs, Room(40, 6, pairs))
        assert capacity.likely_room(inputs) == Room(45, 7, room + 1)


def test_a_capture_without_a_frame_before_it_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(capacity, "_TAKEN", {})
    inputs: Any = SomeInputs("cuda:0")
    monkeypatch.setattr(torch.cuda, "is_current_stream_capturing", lambda: True)
    with pytest.raises(RuntimeError, match=r"no frame of 4321 x 76 was rendered on cuda:0 before: render one first"):
        capacity.room_in_graph(inputs)
    capacity.took(inputs, Room(50, 7, 1000))
    capacity.took(inputs, Room(1, 7, 10))
    assert capacity.room_in_graph(inputs) == Room(100, 7, 1470 + 1024)
    monkeypatch.setattr(capacity, "GRAPH_ROOM", 0)
    assert capacity.room_in_graph(inputs) == Room(73, 7, 1470)
    monkeypatch.setattr(torch.cuda, "is_current_stream_capturing", lambda: False)
    assert capacity.room_in_graph(inputs) is None


@pytest.mark.parametrize("beyond", range(3), ids=["Gaussians", "convexes", "pairs"])
def test_a_replay_that_left_something_out_is_noticed_and_the_next_graph_has_room(monkeypatch: pytest.MonkeyPatch, beyond: int) -> None:
    monkeypatch.setattr(capacity, "_TAKEN", {})
    monkeypatch.setattr(torch.cuda, "is_current_stream_capturing", lambda: True)
    inputs: Any = SomeInputs("cuda:0")
    inputs.n, inputs.m = 10_000, 10_000
    capacity.took(inputs, Room(20, 20, 20))
    room = capacity.room_in_graph(inputs)
    assert room is not None
    counts = torch.tensor([*room, 0])
    with capacity.watching(torch.device("cpu")) as frames:
        capacity.captured(inputs, room, counts)
    assert not frames[0].overflowed(), "exactly full is not too full"
    frames[0].most[beyond] += 1
    assert frames[0].overflowed()
    again = capacity.room_in_graph(inputs)
    assert again is not None and again[beyond] == int(1.5 * (room[beyond] + 1)) + 1024


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
def test_views_that_were_copied_before_are_told_apart_by_their_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    """A camera on the CPU is copied once, as long as its numbers stay the same."""
    scene, _ = some_scene(extras=None)
    monkeypatch.setattr(state, "_THERE", {})
    monkeypatch.setattr(state, "MOST_THERE", 2)
    with launching("cpu", Emulator()), torch.no_grad():
        first = scene.render("cuda")
        assert torch.equal(scene.render("cuda").color, first.color) and len(state._THERE) == 1
        scene.camera.K[0, 0] *= 1.5
        wide = scene.render("cuda")
        scene.background += 0.5
        bright = scene.render("cuda")
        assert len(state._THERE) == 1, "two are the most, and then it begins anew"
    assert not torch.equal(wide.color, first.color) and not torch.equal(wide.color, bright.color)
    assert float((wide.color - scene.render("cpu").color + 0.5 * (1 - wide.alpha[..., None])).abs().max()) < 1e-4


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
