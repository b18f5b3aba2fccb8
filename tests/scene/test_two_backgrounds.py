"""The CPU's image terms on two backgrounds, with weights, a camera's recording and alpha, against plain torch in float64."""

from types import SimpleNamespace

import pytest
import torch
from e4dgs.scene.losses.appearance import appearance_loss
from e4dgs.scene.settings import TrainingSettings

SETTINGS = TrainingSettings(l1_weight=0.7, ssim_weight=0.3, alpha_weight=0.5)
BACKGROUND = (0.1, 0.0, 0.9)
SIZES = [(1, 1), (5, 3), (9, 33), (71, 101)]
PARTS = [set(), {"weight"}, {"recording"}, {"weight", "recording"}, {"kept", "weight"}, {"kept", "weight", "recording"}]


def given(size, parts, seed=0):
    """Named inputs: an image with alpha, and what belongs to ``parts``."""
    draw = torch.Generator().manual_seed(seed)
    target, known = torch.rand(*size, 3, generator=draw), torch.rand(size, generator=draw)
    weight = 4 * torch.rand(size, generator=draw)
    weight[weight < 1] = 0
    kept = torch.rand(size, generator=draw) < 0.7
    image = (target + 0.2 * torch.randn(target.shape, generator=draw)).clamp(0, 1)
    alpha = (known + 0.2 * torch.randn(size, generator=draw)).clamp(0, 1)
    inputs = {"image": image, "target": target, "alpha": alpha, "known": known}
    inputs |= {"kept": kept} if "kept" in parts else {}
    inputs |= {"weight": weight * kept if "kept" in parts else weight} if "weight" in parts else {}
    return inputs | ({"gain": torch.tensor([1.2, 0.9, 1.05]), "offset": torch.tensor([0.03, -0.02, 0.01])} if "recording" in parts else {})


def loss_of(image, target, alpha, known, kept=None, weight=None, gain=None, offset=None):
    """`appearance_loss`, of whatever type the image has: float32 is the kernel, float64 plain torch."""
    recording = None if gain is None else (gain, offset)
    frame = SimpleNamespace(color=image, alpha=alpha)
    rendered = SimpleNamespace(frame=frame, target=target, kept=kept, weight=weight, recording=recording, share=0.6)
    return appearance_loss(rendered, SETTINGS, BACKGROUND, known)


def outcome(inputs):
    """The loss, and the gradients of three times it."""
    leaves = {name: inputs[name].detach().clone().requires_grad_() for name in ("image", "alpha", "gain", "offset") if name in inputs}
    loss = loss_of(**(inputs | leaves))
    return {"loss": loss.detach()} | dict(zip(leaves, torch.autograd.grad(3 * loss, list(leaves.values()))))


def exactly(inputs):
    return outcome({name: p.double() if p.is_floating_point() else p for name, p in inputs.items()})


def assert_close(found, expected):
    assert found.keys() == expected.keys()
    assert abs(float(found["loss"]) - float(expected["loss"])) <= 2e-6
    for name, value in expected.items():
        assert (found[name] - value).norm() <= 2e-5 * value.norm() + 1e-9, name


@pytest.mark.parametrize("size", SIZES, ids=str)
@pytest.mark.parametrize("parts", PARTS, ids=lambda parts: "-".join(sorted(parts)) or "plain")
def test_loss_and_gradients_match_float64(size, parts):
    inputs = given(size, parts)
    assert_close(outcome(inputs), exactly(inputs))


def test_the_oracle_s_gradients_match_central_differences():
    inputs = {name: p.double() if p.is_floating_point() else p for name, p in given((4, 5), {"weight"}).items()}
    inputs["weight"] = torch.ones(4, 5, dtype=torch.float64)  # other weights are factors on the gradient alone

    def loss(image, alpha):
        return loss_of(**(inputs | {"image": image, "alpha": alpha}))

    assert torch.autograd.gradcheck(loss, [inputs["image"].requires_grad_(), inputs["alpha"].requires_grad_()], eps=1e-7, atol=1e-6)


def test_where_no_pixel_counts_there_is_neither_loss_nor_gradient():
    inputs = given((9, 33), {"kept", "weight", "recording"})
    inputs["weight"], inputs["kept"] = torch.zeros(9, 33), torch.zeros(9, 33, dtype=torch.bool)
    found = outcome(inputs)
    assert abs(float(found.pop("loss"))) <= 1e-6 and not any(p.any() for p in found.values())


def test_what_is_not_kept_does_not_reach_the_pixels_beside():
    inputs = given((9, 40), {"kept", "weight"})
    inputs["kept"] = torch.arange(40)[None].expand(9, 40) < 20
    inputs["weight"] = inputs["kept"].float()
    found = outcome(inputs)
    assert_close(found, exactly(inputs))
    assert not found["image"][:, 20:].any() and not found["alpha"][:, 20:].any() and found["alpha"][:, :20].any()


def test_alpha_that_is_not_a_number_shows():
    """The guard of the training looks at the loss."""
    inputs = given((9, 33), set())
    inputs["alpha"][3, 4] = float("nan")
    assert outcome(inputs)["loss"].isnan()


def test_bit_equal_for_any_number_of_threads():
    inputs = given((131, 48), {"kept", "weight", "recording"})
    before, results = torch.get_num_threads(), []
    try:
        for threads in (1, 2, 4):
            torch.set_num_threads(threads)
            results.append(outcome(inputs))
    finally:
        torch.set_num_threads(before)
    assert all(torch.equal(p, results[0][name]) for result in results for name, p in result.items())


def test_tensors_may_have_any_strides():
    inputs = given((9, 33), {"kept", "weight", "recording"})
    across = {name: torch.stack([p, p], -1)[..., 0] for name, p in inputs.items()}
    assert not across["kept"].is_contiguous()
    found, expected = outcome(across), outcome(inputs)
    assert all(torch.equal(p, expected[name]) for name, p in found.items())
