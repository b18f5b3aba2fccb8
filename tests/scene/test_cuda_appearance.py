"""The GPU's image terms with weights, a camera's recording and alpha, in the emulator, against plain torch in float64."""

import pytest
import torch
from composed_appearance import BACKGROUND, SETTINGS, SHARE, assert_close, composed, exactly, given, outcome
from e4dgs.rasterizer.cuda.runtime import launcher_for
from e4dgs.scene.cuda.opposite import Opposite
from e4dgs.scene.cuda.photometric import photometric_loss
from e4dgs.scene.losses import photometric
from e4dgs.scene.losses.appearance import OTHER_BACKGROUND
from pretend_cuda import pretending_cuda
from simt import CHECKED, RACES, Emulator

pytestmark = pytest.mark.usefixtures("emulated")

SIZES = [(1, 1), (5, 3), (9, 33), (33, 17), (2, 70)]  # a tile is 8 x 32
PARTS = [
    set(),
    {"alpha"},
    {"weight"},
    {"recording"},
    {"weight", "recording"},
    {"alpha", "weight"},
    {"alpha", "kept", "weight"},
    {"alpha", "kept", "weight", "recording"},
]


def on(launcher):
    def run(image, target, alpha=None, known=None, kept=None, weight=None, gain=None, offset=None):
        change = tuple(1 - 2 * level for level in BACKGROUND)
        opposite = None if alpha is None else Opposite(alpha, known, kept, change, OTHER_BACKGROUND, SHARE * SETTINGS.alpha_weight)
        recording = None if gain is None else (gain, offset)
        weights = SHARE * SETTINGS.l1_weight, SHARE * SETTINGS.ssim_weight
        return photometric_loss(launcher, image, target, *weights, weight, recording, opposite)

    return run


@pytest.mark.parametrize("size", SIZES, ids=str)
@pytest.mark.parametrize("parts", PARTS, ids=lambda parts: "-".join(sorted(parts)) or "plain")
def test_loss_and_gradients_match_float64(size, parts):
    inputs = given(size, parts)
    assert_close(outcome(on(Emulator()), inputs), exactly(inputs))


@pytest.mark.parametrize("alpha", [False, True])
def test_where_no_pixel_counts_there_is_neither_loss_nor_gradient(alpha):
    inputs = given((9, 33), {"weight", "recording"} | ({"alpha", "kept"} if alpha else set()))
    inputs["weight"] = torch.zeros(9, 33)
    if alpha:
        inputs["kept"] = torch.zeros(9, 33, dtype=torch.bool)
    found = outcome(on(Emulator()), inputs)
    assert abs(float(found.pop("loss"))) <= 1e-7 and not any(p.any() for p in found.values())


def test_what_is_not_kept_does_not_reach_the_pixels_beside():
    inputs = given((9, 40), {"alpha", "kept", "weight"})
    inputs["kept"] = torch.arange(40)[None].expand(9, 40) < 20
    inputs["weight"] = inputs["kept"].float()
    found = outcome(on(Emulator()), inputs)
    assert_close(found, exactly(inputs))
    assert not found["image"][:, 20:].any() and not found["alpha"][:, 20:].any() and found["alpha"][:, :20].any()


@pytest.mark.parametrize("emulator", [Emulator(3), Emulator(flags=CHECKED), Emulator(flags=RACES)], ids=["order", "checked", "races"])
@pytest.mark.parametrize("parts", [PARTS[1], PARTS[-1]], ids=["alpha", "all"])
def test_any_order_of_threads_gives_the_same_bits(emulator, parts):
    inputs = given((19, 40), parts)
    found, expected = (outcome(on(launcher), inputs) for launcher in (emulator, Emulator()))
    assert all(torch.equal(p, expected[name]) for name, p in found.items())


def test_tensors_may_have_any_strides():
    inputs = given((9, 33), PARTS[-1])
    across = {name: torch.stack([p, p], -1)[..., 0] for name, p in inputs.items()}
    assert not across["kept"].is_contiguous()
    found, expected = outcome(on(Emulator()), across), outcome(on(Emulator()), inputs)
    assert all(torch.equal(p, expected[name]) for name, p in found.items())


def test_the_recording_learns_even_if_the_render_does_not():
    inputs = given((9, 33), {"recording"})
    gain = inputs["gain"].clone().requires_grad_()
    loss = on(Emulator())(inputs["image"], inputs["target"], gain=gain, offset=inputs["offset"])
    (found,) = torch.autograd.grad(3 * loss, gain)
    assert torch.equal(found, outcome(on(Emulator()), inputs)["gain"])


WRONG = [
    ("weight", torch.ones(9, 32)),
    ("known", torch.ones(3, 3)),
    ("gain", torch.ones(1)),
    ("kept", torch.ones(9, 33)),
    ("alpha", torch.ones(9, 33).double()),
]


@pytest.mark.parametrize(("name", "value"), WRONG, ids=lambda one: one if isinstance(one, str) else "")
def test_what_the_kernels_do_not_take_is_refused(name, value):
    with pytest.raises(ValueError, match="must be"):
        outcome(on(Emulator()), given((9, 33), PARTS[-1]) | {name: value})


@pytest.mark.parametrize("parts", [PARTS[-1], {"weight", "recording"}, {"alpha"}], ids=["all", "without alpha", "alpha"])
def test_on_a_gpu_two_kernels_do_it_all_and_nothing_waits(parts):
    inputs = given((9, 33), parts)
    expected = outcome(on(Emulator()), inputs)
    with pretending_cuda() as pretending:
        there = {name: p.cuda() for name, p in inputs.items()}
        pretending.syncs.clear()
        found = outcome(composed, there)
        assert pretending.kernels == ["photometric_loss", "photometric_gradient"] and not pretending.syncs
        assert all(torch.equal(p.cpu(), expected[name]) for name, p in found.items())


def test_weight_and_recording_of_the_plain_loss_are_the_kernel_s_too():
    inputs = given((9, 33), {"weight", "recording"})

    def plain(image, target, weight, gain, offset):
        return photometric.photometric_loss(image, target, 0.7, 0.3, weight, (gain, offset))

    with pretending_cuda() as pretending:
        found = outcome(plain, {name: p.cuda() for name, p in inputs.items()})
        assert pretending.kernels == ["photometric_loss", "photometric_gradient"]
    expected = outcome(plain, {name: p.double() for name, p in inputs.items()})
    assert_close({name: p.cpu() for name, p in found.items()}, expected)


@pytest.mark.cuda
@pytest.mark.parametrize("size", [*SIZES, (211, 333)], ids=str)
@pytest.mark.parametrize("parts", PARTS, ids=lambda parts: "-".join(sorted(parts)) or "plain")
def test_on_a_gpu_loss_and_gradients_match_float64(size, parts):
    inputs = given(size, parts)
    there = {name: p.cuda() for name, p in inputs.items()}
    first, second = (outcome(on(launcher_for(torch.device("cuda"))), there) for _ in range(2))
    assert all(torch.equal(p, second[name]) for name, p in first.items())
    assert_close({name: p.cpu() for name, p in first.items()}, exactly(inputs))
