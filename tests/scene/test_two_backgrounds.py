"""The CPU's image terms on two backgrounds, with weights, a camera's recording and alpha, against plain torch in float64."""

import pytest
import torch
from composed_appearance import assert_close, composed, exactly, given, outcome

SIZES = [(1, 1), (5, 3), (9, 33), (71, 101)]
PARTS = [set(), {"weight"}, {"recording"}, {"weight", "recording"}, {"kept", "weight"}, {"kept", "weight", "recording"}]


@pytest.mark.parametrize("size", SIZES, ids=str)
@pytest.mark.parametrize("parts", PARTS, ids=lambda parts: "-".join(sorted(parts)) or "plain")
def test_loss_and_gradients_match_float64(size, parts):
    inputs = given(size, {"alpha", *parts})
    assert_close(outcome(composed, inputs), exactly(inputs))


def test_the_oracle_s_gradients_match_central_differences():
    inputs = {name: p.double() if p.is_floating_point() else p for name, p in given((4, 5), {"alpha", "weight"}).items()}
    inputs["weight"] = torch.ones(4, 5, dtype=torch.float64)  # other weights are factors on the gradient alone

    def loss(image, alpha):
        return composed(**(inputs | {"image": image, "alpha": alpha}))

    assert torch.autograd.gradcheck(loss, [inputs["image"].requires_grad_(), inputs["alpha"].requires_grad_()], eps=1e-7, atol=1e-6)


def test_where_no_pixel_counts_there_is_neither_loss_nor_gradient():
    inputs = given((9, 33), {"alpha", "kept", "weight", "recording"})
    inputs["weight"], inputs["kept"] = torch.zeros(9, 33), torch.zeros(9, 33, dtype=torch.bool)
    found = outcome(composed, inputs)
    assert abs(float(found.pop("loss"))) <= 1e-6 and not any(p.any() for p in found.values())


def test_what_is_not_kept_does_not_reach_the_pixels_beside():
    inputs = given((9, 40), {"alpha", "kept", "weight"})
    inputs["kept"] = torch.arange(40)[None].expand(9, 40) < 20
    inputs["weight"] = inputs["kept"].float()
    found = outcome(composed, inputs)
    assert_close(found, exactly(inputs))
    assert not found["image"][:, 20:].any() and not found["alpha"][:, 20:].any() and found["alpha"][:, :20].any()


def test_alpha_that_is_not_a_number_shows():
    """The guard of the training looks at the loss."""
    inputs = given((9, 33), {"alpha"})
    inputs["alpha"][3, 4] = float("nan")
    assert outcome(composed, inputs)["loss"].isnan()


def test_bit_equal_for_any_number_of_threads():
    inputs = given((131, 48), {"alpha", "kept", "weight", "recording"})
    before, results = torch.get_num_threads(), []
    try:
        for threads in (1, 2, 4):
            torch.set_num_threads(threads)
            results.append(outcome(composed, inputs))
    finally:
        torch.set_num_threads(before)
    assert all(torch.equal(p, results[0][name]) for result in results for name, p in result.items())


def test_tensors_may_have_any_strides():
    inputs = given((9, 33), {"alpha", "kept", "weight", "recording"})
    across = {name: torch.stack([p, p], -1)[..., 0] for name, p in inputs.items()}
    assert not across["kept"].is_contiguous()
    found, expected = outcome(composed, across), outcome(composed, inputs)
    assert all(torch.equal(p, expected[name]) for name, p in found.items())
