"""`e4dgs bench`: every row at a tiny size, what is written, and that the torch peers compute what they are compared with."""

import json
import math

import numpy as np
import pytest
import torch
from e4dgs.pipeline import SettingsError
from e4dgs.rasterizer import rasterize
from e4dgs.rasterizer.reference.compare import relative_l2
from e4dgs.workflows.bench import scenes
from e4dgs.workflows.bench.rows import Bench, Check
from e4dgs.workflows.bench.suites import SUITES
from e4dgs.workflows.bench.timing import interleaved
from pretend_cuda import pretending_cuda
from simt import needs_compiler

TINY = ("--scale", "0.001", "--repeats", "1", "--seconds", "0")
ROWS = [(suite, row.name) for suite, rows in SUITES.items() for row in rows]


@pytest.fixture(autouse=True)
def one_thread():
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


@pytest.fixture
def cli(cli, monkeypatch):
    """The command line on the real reconstruction, whose stages read the capture of a step."""
    from e4dgs.workflows.reconstruction import reconstruction

    monkeypatch.setattr("e4dgs.workflows.session.reconstruction", reconstruction)
    return cli


@pytest.fixture
def gpu(monkeypatch):
    """A pretended one, with what the benchmark asks of torch beside tensors. Its times mean nothing."""
    asked = {"memory_allocated": 0, "max_memory_allocated": 1 << 20, "reset_peak_memory_stats": None, "mem_get_info": (1 << 27, 1 << 27)}
    with pretending_cuda(), monkeypatch.context() as patch:
        for name, value in asked.items():
            patch.setattr(torch.cuda, name, lambda value=value: value)
        patch.setattr(torch.cuda, "get_device_name", lambda index: "pretended")
        patch.setattr("e4dgs.workflows.bench.cuda.first_use._seconds", lambda cache: 1.0)
        yield


@pytest.mark.parametrize(("suite", "row"), [pytest.param(*row, marks=needs_compiler if row[0] == "cuda" else ()) for row in ROWS])
def test_every_row_measures_and_writes(request, cli, tmp_path, suite, row):
    out = tmp_path / "out.json"
    if suite == "cuda":
        request.getfixturevalue("gpu")
    result = cli("bench", suite, "--rows", row, "--out", out, "--debug", *TINY)
    assert result.code == 0, result.err
    written = json.loads(out.read_text())
    assert {"processor", "cores", "compiler", "versions", "date", "commit", "kernels", "threads"} <= written["machine"].keys()
    assert written["machine"]["versions"]["torch"] == torch.__version__
    assert written["protocol"]["scale"] == 0.001 and not written["protocol"]["judged"]
    (found,) = written["rows"].values()
    assert found["protocol"] and (found["checks"] or found["curves"])
    for check in found["checks"]:
        assert check["value"] is not None and math.isfinite(check["value"]), check
        if check["bar"] is not None:
            assert "not judged" in result.out and check["passed"] in (True, False)


def test_list_names_every_row_and_measures_nothing(cli):
    for suite, rows in SUITES.items():
        lines = cli("bench", suite, "--list").out.splitlines()
        assert [line.split()[0] for line in lines] == [row.name for row in rows]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("raster", "--rows", "garden,nope"), "--rows nope: there is no such row; rows: garden, torch"),
        (("raster", "--garden", "nope.npz"), "--garden nope.npz: there is no such file"),
        (("field", "--plot", "curves.bmp"), "must end in .svg or .png"),
        (("step", "--capture", "nope", "--rows", "step"), "nope"),
        (("cuda", "--rows", "convexes"), "there is nothing to measure on"),
    ],
)
def test_a_bad_argument_is_one_message(cli, arguments, message):
    result = cli("bench", *arguments)
    assert result.code == 2 and message in result.err


def test_plots_are_drawn_and_repeat_to_the_byte(tmp_path):
    from e4dgs.workflows.bench.plots import draw

    curves = [
        {"plot": "over_pixels", "label": "Gaussians", "x": [1e3, 1e4], "y": [2.0, 9.0], "x_title": "pixels", "y_title": "ms", "names": []},
        {"plot": "knobs", "label": "SH 0", "x": [3.0], "y": [1e-3], "x_title": "ms", "y_title": "error", "names": ["SH 0"]},
    ]
    files = draw(tmp_path / "speed.svg", {"row": {"curves": curves}})
    assert [path.name for path in files] == ["speed-over_pixels.svg", "speed-knobs.svg"]
    first = [path.read_bytes() for path in files]
    assert [path.read_bytes() for path in draw(tmp_path / "speed.svg", {"row": {"curves": curves}})] == first


def test_a_bar_holds_on_its_own_side_only():
    assert Check("ratio", 3.0, 2.0).passed is False and Check("ratio", 1.0, 2.0).passed is True
    assert Check("ratio", 3.0, 2.0, "above").passed is True and Check("ratio", 1.0).passed is None
    assert Check("ratio", float("nan"), 2.0).passed is False and Check("ratio", float("nan"), 2.0, "above").passed is False


def test_contenders_take_turns_and_one_that_is_slow_runs_less():
    order = []
    clock = {"fast": lambda: order.append("fast"), "slow": lambda: order.append("slow")}
    times = interleaved(Bench(seconds=20), clock, 3)
    assert order == ["fast", "slow", "fast", "slow", "slow", "fast", "fast", "slow"]
    assert [len(t.runs) for t in times.values()] == [3, 3]
    assert len(interleaved(Bench(seconds=0), clock, 3)["slow"].runs) == 1


def small_scene(degree):
    scene = scenes.cloud(150, 48, 36, degree, size=0.2)
    scene.background = torch.tensor([0.2, 0.5, 0.8])
    return scene


@pytest.mark.parametrize("degree", [None, 2])
def test_the_torch_rasterizer_equals_the_reference(degree):
    """Also where a tile's list is longer than one block, and where pixels stop."""
    from e4dgs.rasterizer.reference.compare import decided_by_threshold
    from e4dgs.workflows.bench.peers.rasterizer import rasterize_torch
    from e4dgs.workflows.bench.render import count_pairs

    scene = small_scene(degree)
    pairs = count_pairs(scene)
    assert pairs.blended < 0.99 * pairs.visible, "some pixels stop"
    decided = decided_by_threshold(scene)
    assert float(decided.double().mean()) < 0.25
    weights = torch.randn(36, 48, 3, generator=torch.Generator().manual_seed(0)) * ~decided[..., None]
    found = {}
    for name, render in (("torch", rasterize_torch), ("reference", rasterize)):
        leaves = scene.primitive_leaves()
        attached = scene.having(leaves)
        options = {"backend": "reference"} if name == "reference" else {"block": 16, "together": 5}
        frame = render(attached.camera, attached.gaussians, None, attached.background, **options)
        (frame.color * weights.to(frame.color.dtype)).sum().backward()
        found[name] = frame, {field: leaf.grad for field, leaf in leaves.items()}
    (ours, gradients), (want, exact) = found["torch"], found["reference"]
    for name in ("color", "alpha", "depth"):
        assert float((getattr(ours, name) - getattr(want, name))[~decided].abs().max()) < 1e-4, name
    for name, value in exact.items():
        assert relative_l2(gradients[name], value) < 1e-3, name


@pytest.mark.parametrize("lookup", ["grid_sample", "gather"])
def test_the_composed_field_equals_the_field(lookup):
    from e4dgs.workflows.bench.field.field import errors_of, outcome, outer_gradients, trained_field
    from e4dgs.workflows.bench.peers.field import TorchField

    field, rest = trained_field(16), torch.rand(200, 3, generator=torch.Generator().manual_seed(1)) * 2.4 - 1.2
    weights = outer_gradients(field, rest)
    exact = TorchField(field.state_dict(), torch.float64, lookup)
    assert max(errors_of(outcome(field, rest, weights), outcome(exact, rest, weights)).values()) < 1e-4
    assert float(field.regulariser()) == pytest.approx(float(exact.regulariser()), rel=1e-5)
    for ours, theirs in zip(field.priors(rest, rest + 0.01, 0.0, 0.1), exact.priors(rest.double(), rest.double() + 0.01, 0.0, 0.1)):
        assert float(ours) == pytest.approx(float(theirs), rel=1e-3)


def test_the_torch_loss_equals_the_oracle():
    from e4dgs.workflows.bench.field.loss import images, oracle, outcome
    from e4dgs.workflows.bench.peers.loss import torch_loss

    target, image = (x.double() for x in images(40, 30))
    for got, want in zip(outcome(torch_loss, image, target), outcome(oracle, image, target)):
        assert relative_l2(got, want) < 1e-12


def test_the_composed_step_computes_what_ours_computes():
    """Two trainers from one model take a period of steps; their Gaussians end in the same place, as far as float32 allows."""
    from e4dgs.workflows.bench.peers.step import composed_of_torch, torch_kernels, with_torch_adam
    from e4dgs.workflows.bench.step.training import PERIOD, copy_of, make_model, make_trainer, views_of

    bench = Bench(scale=0.01)
    views, masks, _ = views_of(bench)
    model = make_model(bench, views, masks)
    start = model.gaussians.sh_dc.detach().clone()
    peer = composed_of_torch(copy_of(model))
    ours, step = make_trainer(model, views)
    theirs, torch_step = make_trainer(peer, views)
    with_torch_adam(theirs)
    for _ in range(PERIOD):
        step()
        with torch_kernels():
            torch_step()
    assert ours.loss.value() == pytest.approx(theirs.loss.value(), rel=1e-2)
    moved, moved_too = model.gaussians.sh_dc.detach() - start, peer.gaussians.sh_dc.detach() - start
    assert relative_l2(moved_too, moved) < 0.1


def test_the_parts_of_a_step_sum_to_the_whole():
    from e4dgs.workflows.bench.step import split

    found = split.measure(Bench(scale=0.02, repeats=2))
    parts = found.numbers["parts_ms"]
    assert sum(parts.values()) == pytest.approx(found.numbers["whole_ms"], rel=0.05)
    assert all(parts[part] > 0 for part in split.PARTS)


def test_gaussians_that_stand_for_convexes_cover_as_many_pixels():
    from e4dgs.workflows.bench.raster.convexes import counterpart
    from e4dgs.workflows.bench.render import count_pairs

    shapes = scenes.convexes(300, 200, 140)
    gaussians = counterpart(shapes)
    assert count_pairs(gaussians).visible == pytest.approx(count_pairs(shapes).visible, rel=0.05)
    assert torch.allclose(gaussians.gaussians.means, shapes.convexes.points.mean(1))


def test_the_garden_scene_is_read_from_its_file(tmp_path):
    path = tmp_path / "garden.npz"
    rng = np.random.default_rng(0)
    K = np.array([[[30.0, 0, 16], [0, 30, 12], [0, 0, 1]]])
    arrays = {"means3d": rng.normal((0, 0, 4), 1, (50, 3)), "colors": rng.integers(0, 256, (50, 3)), "Ks": K}
    np.savez(path, **arrays, viewmats=np.eye(4)[None], width=64, height=48)
    scene, name = scenes.garden(Bench(garden=path))
    assert name == "garden.npz, 50 Gaussians, 64x48"
    assert torch.equal(scene.gaussians.means, torch.tensor(arrays["means3d"], dtype=torch.float32))
    half, _ = scenes.garden(Bench(scale=0.25, garden=path))
    assert len(half.gaussians.means) == 13 and half.camera.width == 32 and float(half.camera.K[0, 0]) == 15
    np.savez(path, means3d=arrays["means3d"])
    with pytest.raises(SettingsError, match=r"garden\.npz: expected arrays means3d, colors"):
        scenes.garden(Bench(garden=path))
