"""What only the C++ kernels have: several instruction sets, chunks and blocks of a tile, gradients computed on demand, kept state."""

import pytest
import torch

from .compare import assert_gradients_close, assert_images_close, cotangents, decided_by_threshold, gradients
from .kernels import needs_cpu
from .scenes import Scene, generator, make_camera, random_convexes, random_scene, through_the_camera, uniform

pytestmark = needs_cpu


def check(scene: Scene, max_decided: float = 0.05) -> None:
    single = scene.to(torch.float32)
    want, decided = single.render("reference"), decided_by_threshold(single)
    assert_images_close(single.render("cpu"), want, decided, max_decided=max_decided)
    weights = cotangents(want, ignore=decided)
    assert_gradients_close(gradients(single, "cpu", weights), gradients(single, "reference", weights), relative=1e-4)


@pytest.mark.parametrize("antialiased", [False, True])
@pytest.mark.parametrize("points", [3, 6, 8])
def test_every_instruction_set_agrees_with_the_reference(instruction_set: str, points: int, antialiased: bool) -> None:
    options = {"degree": 2, "extras": 3, "width": 43, "height": 29, "antialiased": antialiased}
    check(random_scene(11, gaussians=50, convexes=25, points=points, **options))


def test_every_instruction_set_clips_and_fades_as_the_reference(instruction_set: str) -> None:
    check(through_the_camera(12, gaussians=60, convexes=40, degree=1, size=0.3, width=43, height=29), max_decided=0.15)


@pytest.mark.parametrize("seed", range(12))
def test_slots_without_an_edge_add_nothing(instruction_set: str, seed: int) -> None:
    """A hull of six points mostly has fewer edges. Few pixels, so that what the other slots would add to tau's gradient is not lost."""
    check(Scene(make_camera(3, 9, seed), None, random_convexes(seed, 1, 6, None, None), uniform(generator(seed), 0, 1, 3)), max_decided=1.0)


def test_an_unknown_instruction_set_is_refused() -> None:
    from e4dgs.rasterizer import _cpu

    before = _cpu.kernels()
    assert not _cpu.select_kernels("mmx")
    assert _cpu.kernels() == before


def test_a_tile_with_more_layers_than_a_chunk(instruction_set: str) -> None:
    """A tile gathers 128 primitives at a time; here some 300 faint ones lie on each, of both kinds."""
    scene = random_scene(12, gaussians=200, convexes=100, degree=0, width=20, height=18, size=1.5, spread=0.5)
    assert scene.gaussians is not None and scene.convexes is not None
    scene.gaussians.opacities.mul_(0.08)
    scene.convexes.opacities.mul_(0.08)
    check(scene, max_decided=1.0)  # faint layers cross 1/255 everywhere; flips are bounded all the same


def test_a_pixel_that_stops_in_a_later_chunk() -> None:
    scene = random_scene(13, gaussians=400, degree=0, width=20, height=18, size=1.5, spread=0.5)
    assert scene.gaussians is not None
    scene.gaussians.opacities[:] = uniform(generator(1), 0.02, 0.12, 400)
    single = scene.to(torch.float32)
    assert float(single.render("cpu").alpha.max()) > 0.999
    check(scene, max_decided=1.0)


@pytest.mark.parametrize("kind", ["gaussians", "convexes"])
@pytest.mark.parametrize("seed", range(6))
def test_bounds_cut_no_visible_tail(kind: str, seed: int) -> None:
    """One primitive a picture, most of them faint or thin, in either mode: every pixel that the reference blends is blended."""
    for k in range(8):
        scene = random_scene(100 * seed + k, **{kind: 1}, degree=None, width=53, height=38, size=1.2)
        owner = getattr(scene, kind)
        owner.opacities[:] = float(uniform(generator(seed), 0.004, 0.03, 8)[k])
        if kind == "gaussians":
            owner.scales[:, k % 3] *= 1e-3
        scene.antialiased = k % 2 == 1
        single = scene.to(torch.float32)
        got, want, decided = single.render("cpu"), single.render("reference"), decided_by_threshold(single)
        assert torch.equal((got.alpha > 0)[~decided], (want.alpha > 0)[~decided])


def test_only_what_requires_gradients_gets_them_and_the_rest_does_not_change() -> None:
    scene = random_scene(14, gaussians=30, convexes=15, degree=1, extras=2).to(torch.float32)
    weights = cotangents(scene.render("cpu"))
    full = gradients(scene, "cpu", weights)
    for name in scene.tensors():
        leaves = {other: value.detach().clone() for other, value in scene.tensors().items()}
        leaves[name].requires_grad_()
        frame = scene.having(leaves).render("cpu")
        torch.stack([(getattr(frame, key) * w.float()).sum() for key, w in weights.items()]).sum().backward()
        found = leaves[name].grad
        assert found is not None and torch.equal(found, full[name]), name
        assert all(value.grad is None for other, value in leaves.items() if other != name)


@pytest.mark.parametrize("antialiased", [False, True])
@pytest.mark.parametrize("channels", [1, 5, 8, 9])
def test_extras_alone_have_the_gradients_that_they_have_beside_others(instruction_set: str, channels: int, antialiased: bool) -> None:
    """Up to eight channels are summed by a walk of their own. Many layers, so that pixels stop; wide ones, so that tiles share them."""
    scene = random_scene(18, 120, 60, degree=1, extras=channels, width=43, height=29, size=0.8, antialiased=antialiased).to(torch.float32)
    weights = {"extras": cotangents(scene.render("reference"))["extras"]}
    full = gradients(scene, "cpu", weights)
    names = ["gaussians.extras", "convexes.extras"]
    for extras in (lambda value: value, torch.zeros_like):  # those that are zero everywhere are not blended
        leaves = scene.leaves()
        leaves = {
            name: extras(value.detach()).requires_grad_(name in names) if name in names else value.detach()
            for name, value in leaves.items()
        }
        for threads in (1, 3):
            torch.set_num_threads(threads)
            frame = scene.having(leaves).render("cpu")
            found = torch.autograd.grad((frame.extras * weights["extras"].float()).sum(), [leaves[name] for name in names])
            assert all(torch.equal(one, full[name]) and one.any() for one, name in zip(found, names))


def test_without_gradients_nothing_is_kept() -> None:
    frame = random_scene(0, gaussians=5, degree=None).to(torch.float32).render("cpu")
    assert frame.color.grad_fn is None
    scene = random_scene(0, gaussians=5, degree=None).to(torch.float32)
    with torch.no_grad():
        assert scene.having(scene.leaves()).render("cpu").color.grad_fn is None


def test_a_kept_graph_gives_the_same_gradients_again() -> None:
    scene = random_scene(15, gaussians=20, convexes=10, degree=1).to(torch.float32)
    leaves = scene.leaves()
    loss = scene.having(leaves).render("cpu").color.square().sum()
    first = torch.autograd.grad(loss, list(leaves.values()), retain_graph=True)
    again = torch.autograd.grad(loss, list(leaves.values()))
    assert all(torch.equal(a, b) for a, b in zip(first, again))


def test_inputs_changed_in_place_before_backward_are_an_error() -> None:
    scene = random_scene(16, gaussians=5, degree=None).to(torch.float32)
    leaves = scene.leaves()
    loss = scene.having(leaves).render("cpu").color.sum()
    with torch.no_grad():
        leaves["gaussians.means"].add_(1)
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        loss.backward()


def test_second_derivatives_are_a_clear_error() -> None:
    scene = random_scene(17, gaussians=5, degree=None).to(torch.float32)
    leaves = scene.leaves()
    loss = scene.having(leaves).render("cpu").color.square().sum()
    (grad,) = torch.autograd.grad(loss, [leaves["gaussians.means"]], create_graph=True)
    with pytest.raises(RuntimeError, match=r"once_differentiable|differentiate twice"):
        grad.sum().backward()


def test_denormal_numbers_count_as_zero_in_the_kernels_and_nowhere_else(instruction_set: str) -> None:
    """They would cost a hundred cycles each. Neither pass changes the processor's mode for what follows."""
    scene = random_scene(20, gaussians=8, convexes=8, degree=None).to(torch.float32)
    leaves = scene.leaves()
    frame = scene.having(leaves).render("cpu")
    faint = torch.full_like(frame.color, 1e-39)
    found = torch.autograd.grad(frame.color, list(leaves.values()), faint, allow_unused=True)
    assert all(not gradient.any() for gradient in found if gradient is not None)
    dark = {name: faint.new_full(value.shape, 1e-39) for name, value in leaves.items() if name.endswith(("colors", "background"))}
    assert len(dark) == 3 and not scene.having({**leaves, **dark}).render("cpu").color.any()
    assert (faint * 0.5).all()


def test_the_order_of_primitives_without_ties_does_not_matter() -> None:
    scene = random_scene(18, gaussians=80, convexes=40, degree=1, width=50, height=40).to(torch.float32)
    turned = {
        name: value.flip(0).contiguous() if name.split(".")[0] in ("gaussians", "convexes") else value
        for name, value in scene.tensors().items()
    }
    assert torch.equal(scene.render("cpu").color, scene.having(turned).render("cpu").color)


def test_what_cannot_fit_is_refused_with_its_size() -> None:
    """6000 Gaussians that all cover an image of 512 x 512 tiles: 1.6e9 pairs. Nothing of that size is allocated before the refusal."""
    from e4dgs.rasterizer import Camera, Gaussians, rasterize

    n, side = 6000, 8192
    K = torch.tensor([[side, 0, side / 2], [0, side, side / 2], [0, 0, 1.0]])
    pose = torch.eye(4)
    pose[2, 3] = 4.0
    quats = torch.tensor([1.0, 0, 0, 0]).repeat(n, 1)
    gaussians = Gaussians(torch.zeros(n, 3), quats, torch.full((n, 3), 50.0), torch.full((n,), 0.5), colors=torch.zeros(n, 3))
    with pytest.raises(MemoryError, match=r"6000 primitives cover about 1\.5\de\+09 pairs .* in this 8192 x 8192 image, .* GiB"):
        rasterize(Camera(K, pose, side, side), gaussians)


@pytest.mark.parametrize(
    "folder, most, current, prefix",
    [("", "max", "current", ""), ("memory/", "limit_in_bytes", "usage_in_bytes", "total_")],
    ids=["v2", "v1"],
)
def test_pictures_in_the_cache_of_a_container_count_as_free_memory(tmp_path, folder, most, current, prefix) -> None:
    from e4dgs.rasterizer import _cpu

    group = tmp_path / "sys/fs/cgroup" / folder
    group.mkdir(parents=True)
    (tmp_path / "proc").mkdir()
    (tmp_path / "proc/meminfo").write_text("MemTotal: 64 kB\nMemAvailable: 50 kB\n")
    assert _cpu.free_memory(str(tmp_path)) == 50 * 1024
    (group / f"memory.{most}").write_text("10000\n")
    (group / f"memory.{current}").write_text("9900\n")
    (group / "memory.stat").write_text(f"anon 2000\n{prefix}inactive_file 7000\n{prefix}active_file 500\n")
    assert _cpu.free_memory(str(tmp_path)) == 7600
    (group / "memory.stat").write_text("anon 9900\n")
    assert _cpu.free_memory(str(tmp_path)) == 100
    (group / f"memory.{most}").write_text("max\n" if not folder else f"{2**63 - 4096}\n")
    assert _cpu.free_memory(str(tmp_path)) == 50 * 1024


def test_memory_that_frames_hand_on_changes_nothing_and_can_be_given_back() -> None:
    from e4dgs.rasterizer import _cpu

    large = random_scene(19, gaussians=3000, convexes=500, degree=0, width=200, height=150).to(torch.float32)
    small = random_scene(20, gaussians=900, convexes=100, degree=0, width=90, height=70).to(torch.float32)
    _cpu.release_memory()
    first = small.render("cpu").color
    large.render("cpu")
    assert torch.equal(small.render("cpu").color, first)
    released = _cpu.release_memory()  # a sanitized build keeps nothing
    assert released <= _cpu.most_kept_memory and (released > 0) == (_cpu.most_kept_memory > 0)
    assert _cpu.release_memory() == 0
    assert torch.equal(small.render("cpu").color, first)
