"""Metrics against their definitions written out, on images with known answers."""

import math
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from e4dgs.scene.metrics.edge_psnr import edge_psnr
from e4dgs.scene.metrics.flicker import MEASURES, STEADY, Flicker, _moves, steady_pixels
from e4dgs.scene.metrics.lpips import Lpips, expected_shapes
from e4dgs.scene.metrics.psnr import CAP, affine_fit, psnr
from e4dgs.scene.metrics.ssim import ssim, ssim_map
from safetensors.torch import save_file
from torch.nn import functional as F


def picture(height: int = 40, width: int = 52, seed: int = 0) -> np.ndarray:
    """A smooth random picture with one hard edge."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width]
    image = 0.5 + 0.2 * np.stack([np.sin(x / (5 + k) + rng.uniform(0, 6)) * np.cos(y / (7 - k)) for k in range(3)], -1)
    image[:, width // 2 :] *= 0.3
    return image.astype(np.float32)


def test_psnr_of_a_constant_error():
    truth = picture()
    assert psnr(truth.astype(np.float64) + 0.1, truth) == pytest.approx(20.0, abs=1e-9)
    assert psnr(truth, truth) == CAP


def test_psnr_is_float64_where_float32_is_not_enough():
    truth = np.full((64, 64, 3), 0.7)
    assert psnr(truth + 1e-4, truth) == pytest.approx(80.0, abs=1e-6)


def test_psnr_over_a_mask_sees_only_its_pixels():
    truth = picture()
    image = truth.astype(np.float64)
    image[:10] += 0.1
    mask = np.zeros(truth.shape[:2], bool)
    mask[:10] = True
    assert psnr(image, truth, mask) == pytest.approx(20.0, abs=1e-6)
    assert psnr(image, truth, ~mask) == CAP
    with pytest.raises(ValueError, match="no pixel"):
        psnr(image, truth, np.zeros_like(mask))


def test_affine_fit_recovers_gain_and_offset_of_each_channel():
    truth = picture() * 0.5 + 0.2
    image = (truth - np.array([0.05, 0.02, -0.03])) / np.array([1.2, 0.9, 0.8])
    assert psnr(image, truth) < 40
    assert psnr(affine_fit(image, truth), truth) > 90


def test_affine_fit_never_makes_it_worse_and_survives_a_flat_image():
    truth = picture()
    noisy = np.clip(truth + np.random.default_rng(3).normal(0, 0.2, truth.shape), 0, 1)
    assert psnr(affine_fit(noisy, truth), truth) >= psnr(noisy, truth)
    flat = affine_fit(np.full_like(truth, 0.25), truth)
    assert np.allclose(flat, truth.astype(np.float64).mean((0, 1)))


def naive_ssim(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Every window written out, one pixel at a time."""
    r = np.arange(-5, 6)
    w = np.exp(-(r[:, None] ** 2 + r[None] ** 2) / (2 * 1.5**2))
    w /= w.sum()
    out = np.empty(x.shape)
    px, py = (np.pad(v.astype(np.float64), ((5, 5), (5, 5), (0, 0))) for v in (x, y))
    for i in range(x.shape[0]):
        for j in range(x.shape[1]):
            for c in range(3):
                a, b = px[i : i + 11, j : j + 11, c], py[i : i + 11, j : j + 11, c]
                ma, mb = (w * a).sum(), (w * b).sum()
                va, vb, vab = (w * a * a).sum() - ma**2, (w * b * b).sum() - mb**2, (w * a * b).sum() - ma * mb
                out[i, j, c] = (2 * ma * mb + 1e-4) * (2 * vab + 9e-4) / ((ma**2 + mb**2 + 1e-4) * (va + vb + 9e-4))
    return out


@pytest.mark.parametrize("size", [(14, 19), (8, 8), (1, 1)])
def test_ssim_equals_its_definition(size: tuple[int, int]):
    truth = picture(*size)
    image = np.clip(truth + np.random.default_rng(1).normal(0, 0.05, truth.shape), 0, 1)
    assert np.abs(ssim_map(image, truth) - naive_ssim(image, truth)).max() < 1e-12


def test_ssim_orders_blur_noise_and_identity():
    truth = picture()
    assert ssim(truth, truth) == pytest.approx(1.0, abs=1e-12)
    little, much = (np.clip(truth + np.random.default_rng(2).normal(0, s, truth.shape), 0, 1) for s in (0.02, 0.1))
    assert 1 > ssim(little, truth) > ssim(much, truth) > 0
    assert ssim(little, truth) == pytest.approx(ssim(truth, little), abs=1e-12)


def test_edge_psnr_punishes_an_error_on_the_edge_and_ignores_one_away_from_it():
    truth = np.full((40, 60, 3), 0.2)
    truth[:, 30:] = 0.8
    far, near = truth.copy(), truth.copy()
    far[:, :20] += 0.1
    near[:, 28:32] += 0.1
    assert edge_psnr(far, truth) == CAP
    # The contour is one pixel wide, so five columns count and four or all of them carry the error.
    assert edge_psnr(near, truth) == pytest.approx(20.0, abs=1.3)
    assert edge_psnr(near, truth) < psnr(near, truth)


def test_edge_psnr_of_a_truth_without_edges_is_none():
    assert edge_psnr(np.full((8, 8, 3), 0.1), np.full((8, 8, 3), 0.5)) is None


@pytest.mark.parametrize("metric", [psnr, ssim, edge_psnr])
def test_metrics_refuse_what_has_no_answer(metric):
    good = picture()
    bad = good.copy()
    bad[3, 4, 1] = np.nan
    with pytest.raises(ValueError, match="1 values are not finite"):
        metric(bad, good)
    with pytest.raises(ValueError, match="differ in shape"):
        metric(good[:-1], good)
    with pytest.raises(ValueError, match="expected"):
        metric((good * 255).astype(np.uint8), good)


def random_state(net: str) -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    state = {}
    for name, shape in expected_shapes(net).items():
        fan = math.prod(shape[1:]) if len(shape) > 1 else 100
        value = torch.randn(shape, generator=generator) / math.sqrt(fan)
        state[name] = value.abs() if name.startswith("lin") else value
    return state


def alex_by_hand(s: dict[str, torch.Tensor], x: torch.Tensor) -> list[torch.Tensor]:
    a = F.relu(F.conv2d(x, s["features.0.weight"], s["features.0.bias"], stride=4, padding=2))
    b = F.relu(F.conv2d(F.max_pool2d(a, 3, 2), s["features.3.weight"], s["features.3.bias"], padding=2))
    c = F.relu(F.conv2d(F.max_pool2d(b, 3, 2), s["features.6.weight"], s["features.6.bias"], padding=1))
    d = F.relu(F.conv2d(c, s["features.8.weight"], s["features.8.bias"], padding=1))
    e = F.relu(F.conv2d(d, s["features.10.weight"], s["features.10.bias"], padding=1))
    return [a, b, c, d, e]


def vgg_by_hand(s: dict[str, torch.Tensor], x: torch.Tensor) -> list[torch.Tensor]:
    taps = []
    for block in ((0, 2), (5, 7), (10, 12, 14), (17, 19, 21), (24, 26, 28)):
        x = F.max_pool2d(x, 2) if taps else x
        for i in block:
            x = F.relu(F.conv2d(x, s[f"features.{i}.weight"], s[f"features.{i}.bias"], padding=1))
        taps.append(x)
    return taps


@pytest.mark.parametrize(("net", "by_hand"), [("alex", alex_by_hand), ("vgg", vgg_by_hand)])
def test_lpips_equals_a_direct_composition(net, by_hand):
    state = random_state(net)
    truth, image = picture(48, 64), picture(48, 64, seed=4)

    def distance() -> float:
        total = 0.0
        maps = []
        for value in (image, truth):
            x = torch.tensor(value).permute(2, 0, 1)[None] * 2 - 1
            x = (x - torch.tensor([-0.030, -0.088, -0.188]).view(1, 3, 1, 1)) / torch.tensor([0.458, 0.448, 0.450]).view(1, 3, 1, 1)
            maps.append(by_hand(state, x))
        for k, (a, b) in enumerate(zip(*maps)):
            assert a.numel() > 0
            a, b = F.normalize(a, dim=1), F.normalize(b, dim=1)
            total += F.conv2d((a - b) ** 2, state[f"lin{k}.weight"]).mean().item()
        return total

    lpips = Lpips(state, net)
    assert lpips(image, truth) == pytest.approx(distance(), rel=1e-5)
    assert lpips(image, truth) > 0.01
    assert lpips(truth, truth) == 0.0
    assert lpips(image, truth) == lpips(truth, image)


def test_lpips_grows_with_the_distortion():
    lpips = Lpips(random_state("alex"), "alex")
    truth = picture(64, 64)
    noise = np.random.default_rng(5).normal(0, 1, truth.shape)
    distances = [lpips(np.clip(truth + s * noise, 0, 1), truth) for s in (0.0, 0.02, 0.1, 0.3)]
    assert distances == sorted(distances) and distances[0] == 0


def test_lpips_reads_safetensors_and_says_what_is_wrong_with_a_file(tmp_path: Path):
    state = random_state("alex")
    save_file(state, tmp_path / "good.safetensors")
    truth = picture(40, 40)
    assert Lpips.load(tmp_path / "good.safetensors", "alex")(truth, picture(40, 40, 1)) > 0
    with pytest.raises(ValueError, match=r"good\.safetensors.*vgg.*features\.\d+\.weight"):
        Lpips.load(tmp_path / "good.safetensors", "vgg")
    (tmp_path / "cut.safetensors").write_bytes((tmp_path / "good.safetensors").read_bytes()[:1000])
    with pytest.raises(ValueError, match=r"cut\.safetensors"):
        Lpips.load(tmp_path / "cut.safetensors", "alex")
    with pytest.raises(ValueError, match=r"absent\.safetensors"):
        Lpips.load(tmp_path / "absent.safetensors", "alex")


def test_lpips_needs_images_of_32_pixels():
    with pytest.raises(ValueError, match="at least 32 px"):
        Lpips(random_state("alex"), "alex")(picture(31, 40), picture(31, 40))
    assert Lpips(random_state("alex"), "alex")(picture(32, 32), picture(32, 32, 1)) > 0


def flicker_of(renders, truths):
    flicker = Flicker()
    flicker.begin(steady_pixels(truths))
    for render, truth in zip(renders, truths):
        flicker.add(render, truth)
    return flicker


def test_flicker_is_what_the_render_changes_beyond_the_truth():
    truths = [picture()] * 4
    shaking = [truth + 0.01 * (k % 2) for k, truth in enumerate(truths)]
    found = flicker_of(shaking, truths)
    assert len(found.rows) == 3
    assert found.means()["static"] == pytest.approx(2.55, rel=1e-4) and found.means()["edges"] == pytest.approx(2.55, rel=1e-4)
    assert [row["static"] for row in found.rows] == pytest.approx([2.55] * 3, rel=1e-4)
    same = flicker_of(shaking, shaking).means()
    assert same["static"] == 0 and same["edges"] == 0 and same["flow"] == 0
    offset = flicker_of([truth + 0.1 for truth in truths], truths).means()  # wrong, and steady
    assert offset["static"] == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize(("deviation", "steady"), [(0.9 * STEADY, True), (1.1 * STEADY, False)])
def test_flicker_counts_as_static_what_hardly_deviates_over_time(deviation, steady):
    truths = [np.full((8, 9, 3), 0.5 + sign * deviation) for sign in (-1, 1, -1, 1)]
    assert steady_pixels(truths).all() == steady_pixels(truths).any() == steady
    static = flicker_of([np.zeros((8, 9, 3))] * 4, truths).means()["static"]
    assert (static == 0) if steady else (static is None)
    with pytest.raises(ValueError, match="no picture"):
        steady_pixels([])


def test_flicker_begins_anew_with_each_camera_and_measures_flow():
    truth = np.zeros((64, 64, 3))
    truth[20:40, 20:40] = picture(20, 20)
    moved = np.roll(truth, 2, axis=1)
    flicker = Flicker()
    for _ in range(2):
        flicker.begin(steady_pixels([truth, moved]))
        flicker.add(truth, truth)
        flicker.add(truth, moved)  # the render stands still where the truth moves
    assert len(flicker.rows) == 2 and flicker.means()["flow"] > 0.1
    assert Flicker().means() == {"static": None, "edges": None, "warped": None, "flow": None}


def sliding(count=5, step=2, start=0):
    """Pictures of a textured square that slides to the right over a flat ground by ``step`` px a time."""
    coarse = cv2.resize(np.random.default_rng(4).random((8, 8, 3)), (32, 32), interpolation=cv2.INTER_CUBIC).clip(0, 1)
    pictures = []
    for k in range(count):
        image = np.full((64, 96, 3), 0.4)
        left = 10 + start + step * k
        image[16:48, left : left + 32] = coarse
        pictures.append(image)
    return pictures


def test_a_perfect_render_of_something_that_moves_has_no_flicker():
    found = flicker_of(sliding(), sliding()).means()
    assert set(found) == set(MEASURES) and all(value == pytest.approx(0, abs=1e-9) for value in found.values())


def test_noise_on_what_moves_is_the_known_flicker_along_the_motion():
    """Renders are brighter by 5 levels at every second time: their change along the motion exceeds the truth's by 5."""
    renders = [truth + 5 / 255 * (k % 2) for k, truth in enumerate(sliding())]
    found = flicker_of(renders, sliding()).means()
    assert found["warped"] == pytest.approx(5.0, rel=0.03) and found["static"] == pytest.approx(5.0, rel=1e-6)


def test_a_pattern_that_stays_behind_flickers_along_the_motion_alone():
    """Seen from the moving surface it changes, though at each pixel the render changes exactly as the truth does."""
    pattern = 0.04 * np.random.default_rng(6).standard_normal((64, 96, 1))
    found = flicker_of([truth + pattern for truth in sliding()], sliding()).means()
    assert found["static"] == pytest.approx(0, abs=1e-9) and found["edges"] == pytest.approx(0, abs=1e-9)
    assert found["warped"] > 2.0


def test_a_render_that_lags_has_another_flow():
    """The truth speeds up by 1 px a time; a render that is one time behind moves 1 px less."""
    places = [0, 1, 3, 6, 10, 15]
    truths = [sliding(1, start=place)[0] for place in places]
    found = {lag: flicker_of([truths[max(k - lag, 0)] for k in range(6)], truths).means() for lag in (0, 1, 2)}
    assert found[0]["flow"] == 0 and found[0]["warped"] == 0
    assert found[2]["flow"] > found[1]["flow"] > 0.3
    assert found[1]["warped"] > 5.0 and found[1]["edges"] > 3.0


def test_what_stands_still_or_leaves_the_picture_is_no_motion():
    standing = [picture()] * 3
    assert flicker_of(standing, standing).means()["warped"] is None
    out = np.zeros((20, 30, 2), np.float32)
    out[..., 0] = 4.0
    assert _moves(out, -out)[:, :26].all() and not _moves(out, -out)[:, 26:].any(), "the last pixels leave the picture"
    assert not _moves(out, -0.7 * out).any(), "what is hidden at the next time: the way back leads elsewhere"
    assert not _moves(0.1 * out, -0.1 * out).any(), "slower than half a pixel"
