"""Native code of benchmarks: pairs are those of the reference, and the blend limit does as much work as it is asked for."""

import time

import pytest
import torch
from bench_rows.native.counts import blend_limit, count_pairs
from bench_rows.raster.accuracy import large_convexes
from bench_rows.raster.pairs import counterpart
from e4dgs.rasterizer.reference.blend import MAX_ALPHA, MIN_ALPHA, MIN_TRANSMITTANCE
from e4dgs.workflows.bench import scenes
from rasterizer.kernels import instruction_set  # noqa: F401
from rasterizer.thresholds import raw_alphas
from simt import needs_compiler

pytestmark = needs_compiler


@pytest.mark.parametrize("kind", ["gaussians", "convexes", "mixed"])
def test_pairs_are_those_of_the_reference(kind):
    make = {
        "gaussians": lambda: scenes.cloud(150, 48, 36, size=0.3),
        "convexes": lambda: large_convexes(300, 48, 36),
        "mixed": lambda: scenes.mixed(4000, 48, 36),
    }
    scene = make[kind]()
    raw, _ = raw_alphas(scene)
    visible = raw >= MIN_ALPHA
    left = torch.cumprod(1 - torch.where(visible, raw.clamp(max=MAX_ALPHA), 0.0), 1)
    found = count_pairs(scene)
    assert found.visible == int(visible.sum()) > 1000
    assert found.blended == int((visible & (left >= MIN_TRANSMITTANCE)).sum())
    assert kind == "mixed" or found.blended < found.visible, "some pixels stop"


def test_the_number_of_threads_changes_no_count():
    scene = scenes.mixed(200, 48, 36)
    alone = count_pairs(scene)
    torch.set_num_threads(3)
    assert count_pairs(scene) == alone


def test_gaussians_that_stand_for_convexes_cover_as_many_pixels():
    shapes = scenes.convexes(300, 200, 140)
    gaussians = counterpart(shapes)
    assert count_pairs(gaussians).visible == pytest.approx(count_pairs(shapes).visible, rel=0.05)
    assert torch.allclose(gaussians.gaussians.means, shapes.convexes.points.mean(1))


def test_the_limit_takes_longer_for_more_pairs(instruction_set):  # noqa: F811
    def seconds(pairs: int, backward: bool) -> float:
        blend_limit(pairs, backward)
        started = time.thread_time()
        blend_limit(pairs, backward)
        return time.thread_time() - started

    for backward in (False, True):
        assert seconds(32_000_000, backward) > 4 * seconds(1_000_000, backward)
