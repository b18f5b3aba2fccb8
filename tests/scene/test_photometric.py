"""The fused L1 + SSIM against plain torch in float64."""

import pytest
import torch
from e4dgs.scene.losses.photometric import photometric_loss, ssim_reference


def images(height, width, seed=0):
    generator = torch.Generator().manual_seed(seed)
    y = torch.rand(height, width, 3, generator=generator)
    return (y + 0.2 * torch.randn(y.shape, generator=generator)).clamp(0, 1), y


@pytest.mark.parametrize(("height", "width"), [(1, 1), (3, 17), (12, 5), (40, 33), (71, 101)])
@pytest.mark.parametrize(("l1", "ssim"), [(1.0, 0.0), (0.0, 1.0), (0.8, 0.2)])
def test_value_and_gradient_match_the_oracle(height, width, l1, ssim):
    x, y = images(height, width)
    x.requires_grad_()
    loss = photometric_loss(x, y, l1, ssim)
    (ours,) = torch.autograd.grad(loss, x)
    exact = x.detach().double().requires_grad_()
    expected = l1 * (exact - y).abs().mean() + ssim * (1 - ssim_reference(exact, y.double()))
    (theirs,) = torch.autograd.grad(expected, exact)
    assert abs(float(loss) - float(expected)) < 2e-6
    assert (ours - theirs).norm() <= 2e-5 * theirs.norm() + 1e-9


@pytest.mark.parametrize(("height", "width"), [(1, 1), (3, 17), (40, 33), (71, 101)])
def test_weights_scale_gradients_and_pixels_of_weight_zero_do_not_count(height, width):
    x, y = images(height, width)
    weight = torch.rand(height, width, generator=torch.Generator().manual_seed(1)) * 4
    weight[weight < 1] = 0
    x.requires_grad_()
    loss = photometric_loss(x, y, 0.7, 0.3, weight)
    (ours,) = torch.autograd.grad(loss, x)
    exact = torch.where(weight[..., None] > 0, x.detach(), y).double().requires_grad_()
    expected = 0.7 * (exact - y).abs().mean() + 0.3 * (1 - ssim_reference(exact, y.double()))
    (theirs,) = torch.autograd.grad(expected, exact)
    theirs = theirs * weight[..., None]
    assert abs(float(loss) - float(expected)) < 2e-6
    assert (ours - theirs).norm() <= 2e-5 * theirs.norm() + 1e-9
    assert not ours[weight == 0].any()
    double = x.detach().double().requires_grad_()  # the path without a kernel means the same
    composed = photometric_loss(double, y.double(), 0.7, 0.3, weight.double())
    assert float(composed) == pytest.approx(float(expected), abs=1e-12)
    torch.testing.assert_close(torch.autograd.grad(composed, double)[0], theirs)


@pytest.mark.parametrize("weighed", [False, True])
@pytest.mark.parametrize(("height", "width"), [(1, 1), (3, 17), (40, 33), (71, 101)])
def test_the_camera_s_recording_is_part_of_the_loss_and_of_its_gradients(height, width, weighed):
    x, y = images(height, width)
    weight = torch.rand(height, width, generator=torch.Generator().manual_seed(1)) * 4 if weighed else None
    if weight is not None:
        weight[weight < 1] = 0
    inputs = [x, torch.tensor([1.2, 0.9, 1.05]), torch.tensor([0.03, -0.02, 0.0])]
    ours = [one.clone().requires_grad_() for one in inputs]
    theirs = [one.double().requires_grad_() for one in inputs]
    loss = photometric_loss(ours[0], y, 0.7, 0.3, weight, (ours[1], ours[2]))
    exact = None if weight is None else weight.double()
    expected = photometric_loss(theirs[1] * theirs[0] + theirs[2], y.double(), 0.7, 0.3, exact)
    assert float(loss) == pytest.approx(float(expected), abs=2e-6)
    for found, wanted in zip(torch.autograd.grad(3 * loss, ours), torch.autograd.grad(3 * expected, theirs), strict=True):
        assert (found - wanted).norm() <= 3e-5 * wanted.norm() + 1e-9
    composed = photometric_loss(theirs[0], y.double(), 0.7, 0.3, exact, (theirs[1], theirs[2]))
    assert float(composed) == pytest.approx(float(expected), abs=1e-12)


def test_oracle_gradient_matches_central_differences():
    x, y = images(4, 5)
    assert torch.autograd.gradcheck(lambda a: ssim_reference(a, y.double()), x.double().requires_grad_(), eps=1e-6, atol=1e-7)


def test_equal_images_have_no_loss_and_no_gradient():
    _, y = images(20, 20)
    x = y.clone().requires_grad_()
    loss = photometric_loss(x, y)
    loss.backward()
    assert abs(float(loss)) < 1e-6 and x.grad.abs().max() < 1e-6


def test_bit_equal_for_any_number_of_threads():
    x, y = images(131, 48)
    before, results = torch.get_num_threads(), []
    try:
        for threads in (1, 2, 4):
            torch.set_num_threads(threads)
            a, gain, offset = (
                one.clone().requires_grad_() for one in (x, torch.tensor([1.2, 0.9, 1.05]), torch.tensor([0.03, -0.02, 0.0]))
            )
            loss = photometric_loss(a, y, recording=(gain, offset))
            loss.backward()
            results.append((float(loss), torch.cat([one.grad.flatten() for one in (a, gain, offset)])))
    finally:
        torch.set_num_threads(before)
    assert all(r[0] == results[0][0] and torch.equal(r[1], results[0][1]) for r in results)


def test_shapes_are_named():
    with pytest.raises(ValueError, match=r"\(4, 4, 3\) and \(4, 5, 3\)"):
        photometric_loss(torch.zeros(4, 4, 3), torch.zeros(4, 5, 3))
    with pytest.raises(ValueError, match=r"weight must be \[4, 4\], got \[4, 5\]"):
        photometric_loss(torch.zeros(4, 4, 3), torch.zeros(4, 4, 3), weight=torch.zeros(4, 5))
