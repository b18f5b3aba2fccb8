"""The CPU's kernel of what is rendered of primitives, against plain float64 torch."""

import pytest
import torch
from composed_looks import OUTPUTS, assert_close, exactly, given, outcome
from e4dgs.scene import _kernels
from e4dgs.scene.cpu.looks import look

CASES = [(0, 15, 15), (1, 15, 15), (512, 8, 8), (1300, 15, 3), (700, 15, 0), (129, 0, 0)]


@pytest.mark.parametrize("convex", [False, True], ids=["gaussians", "convexes"])
@pytest.mark.parametrize("light", [False, True], ids=["steady", "lit"])
@pytest.mark.parametrize(("n", "stored", "shown"), CASES)
def test_looks_and_their_gradients_match_float64(n, stored, shown, light, convex):
    inputs = given(n, stored, light, convex)
    assert_close(outcome(look, inputs, shown), exactly(inputs, shown))


@pytest.mark.parametrize("used", [*OUTPUTS, "sizes0", "sizes1"])
def test_what_an_output_does_not_depend_on_gets_no_gradient_from_it(used):
    inputs = given(40, 8, convex=True)
    found, expected = outcome(look, inputs, 8, (used,)), exactly(inputs, 8, (used,))
    assert_close(found, expected)
    assert {name for name, p in found.items() if p is None} == {name for name, p in expected.items() if p is None}


def test_what_is_not_rendered_gets_no_gradient():
    """So that the optimiser need not look at it."""
    found = outcome(look, given(20, 15, light=False), 0)
    assert found["g_rest"] is None and found["g_shades"] is None
    assert not outcome(look, given(20, 15), 3)["g_rest"][:, 3:].any()


def test_sizes_and_opacities_at_their_ends():
    """Beyond what float32 holds, sizes are infinite or zero, as exp says; what is not a number stays so."""
    inputs = given(8, 0)
    ends = torch.tensor([-200.0, -87.5, -80, -30, 30, 80, 87.5, float("nan")])
    inputs["logs"], inputs["logits"] = ends[:, None].expand(8, 3).contiguous(), ends
    (sizes,), opacities, _ = look((inputs["logs"],), inputs["logits"], inputs["dc"], inputs["rest"], 0, None, None)
    assert torch.equal(sizes[[0, 1, 6], 0], torch.tensor([0.0, 0.0, torch.inf])) and sizes[7].isnan().all() and opacities[7].isnan()
    assert torch.allclose(sizes[2:6, 0].double(), ends[2:6].double().exp(), rtol=1e-5)
    assert torch.allclose(opacities[1:7].double(), ends[1:7].double().sigmoid(), rtol=1e-5, atol=1e-37)


def test_bit_equal_for_any_number_of_threads():
    before, results = torch.get_num_threads(), []
    try:
        for threads in (1, 2, 5):
            torch.set_num_threads(threads)
            results.append(outcome(look, given(3000), 8))
    finally:
        torch.set_num_threads(before)
    assert all(torch.equal(p, results[0][name]) for result in results for name, p in result.items())


def test_tensors_that_lie_across_others_are_taken():
    inputs = given(40, 8)
    across = {name: torch.stack([p, p], -1)[..., 0] for name, p in inputs.items()}
    found, expected = (outcome(look, one, 8) for one in (across, inputs))
    assert all(torch.equal(p, expected[name]) for name, p in found.items())


WRONG = [
    ("logs", torch.ones(4, 3)),
    ("others", torch.ones(5, 1)),
    ("logits", torch.ones(5, 1)),
    ("dc", torch.ones(5, 3)),
    ("rest", torch.ones(5, 7, 3)),
    ("shades", torch.ones(5, 4)),
    ("light", torch.ones(4)),
]


@pytest.mark.parametrize(("name", "value"), WRONG, ids=str)
def test_what_the_kernels_do_not_take_is_refused(name, value):
    with pytest.raises(ValueError, match="must be"):
        outcome(look, given(5, 8) | {name: value}, 8)


def test_a_light_that_nothing_follows_is_refused():
    inputs = given(5, 8)
    with pytest.raises(ValueError, match="given together"):
        look((inputs["logs"],), inputs["logits"], inputs["dc"], inputs["rest"], 8, None, inputs["light"])


def test_gradients_that_have_no_room_are_refused():
    inputs = [given(5, 8)[name] for name in ("logs", "logits", "dc", "rest")]
    inputs.insert(1, None)
    everything = [*inputs, None, None]
    out = torch.ones(5, 3), None, torch.ones(5), torch.ones(5, 9, 3)
    with pytest.raises(ValueError, match="incoming gradients"):
        _kernels.looks_backward(everything, 8, out, out, [None] * 7, 1)
