"""RAFT: each part against a plain formula, the two correlations against every pair, and weights files that are not what they claim."""

import pickle
from pathlib import Path

import numpy as np
import pytest
import torch
from e4dgs.vision.flow.raft import Raft
from e4dgs.vision.flow.raft.architecture import ARCHITECTURES, BASIC, SMALL, Architecture, blocks, norms
from e4dgs.vision.flow.raft.correlation import Correlation
from e4dgs.vision.flow.raft.layers import context_terms, encode, enlarge, update
from e4dgs.vision.flow.raft.weights import folded, read_weights, recognise
from raft_weights import random_state, torchvisions
from safetensors.torch import save_file
from torch import Tensor
from torch.nn import functional as F

BOTH = pytest.mark.parametrize("a", [BASIC, SMALL], ids=lambda a: a.name)


def picture(height: int, width: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3), dtype=np.uint8)


def plain_lookup(first: Tensor, second: Tensor, at: Tensor, radius: int) -> Tensor:
    """Section 3.2 of the paper as written: all pairs, averaged over the second picture, one bilinear value after the other."""
    _, c, h, w = first.shape
    volume = torch.einsum("chw,cyx->hwyx", first[0].double(), second[0].double())[:, :, None] / c**0.5
    out = []
    for level in range(4):
        pooled = volume.reshape(h * w, 1, *volume.shape[-2:])
        for _ in range(level):
            pooled = F.avg_pool2d(pooled, 2)
        pooled = F.pad(pooled[:, 0], (1, 1, 1, 1))
        for dx in range(-radius, radius + 1):
            for dy in range(-radius, radius + 1):
                value = torch.zeros(h * w, dtype=torch.float64)
                for n in range(h * w):
                    x, y = float(at[0, 0].flatten()[n]) / 2**level + dx, float(at[0, 1].flatten()[n]) / 2**level + dy
                    x0, y0 = int(np.floor(x)), int(np.floor(y))
                    for i, wx in ((x0, 1 - x + x0), (x0 + 1, x - x0)):
                        for j, wy in ((y0, 1 - y + y0), (y0 + 1, y - y0)):
                            if 0 <= i < pooled.shape[2] - 2 and 0 <= j < pooled.shape[1] - 2:
                                value[n] += wx * wy * pooled[n, j + 1, i + 1]
                out.append(value)
    return torch.stack(out).view(1, -1, h, w)


@pytest.mark.parametrize("kernel", [True, False], ids=["kernel", "products"])
@pytest.mark.parametrize(("channels", "radius"), [(32, 1), (37, 2), (5, 1)])
def test_windows_are_those_of_the_volume_of_all_pairs(kernel: bool, channels: int, radius: int) -> None:
    g = torch.Generator().manual_seed(1)
    first, second = (torch.randn(1, channels, 9, 11, generator=g) for _ in range(2))
    at = torch.rand(1, 2, 9, 11, generator=g) * 16 - 3  # beyond every side too
    at[0, :, 0, :3] = torch.tensor([[0.0, 10.0, 4.0], [0.0, 8.0, 4.0]])  # on features: nothing to blend
    found = Correlation(first, second, radius, kernel=kernel)(at)
    assert torch.allclose(found.double(), plain_lookup(first, second, at, radius), atol=2e-5)


def test_the_kernel_is_the_same_for_any_number_of_threads_and_safe_anywhere() -> None:
    g = torch.Generator().manual_seed(2)
    first, second = (torch.randn(1, 128, 16, 24, generator=g) for _ in range(2))
    at = torch.rand(1, 2, 16, 24, generator=g) * 30
    at[0, 0, 0, :6] = torch.tensor([float("nan"), float("inf"), -float("inf"), 3e38, -3e38, 2.0**31])
    correlation, threads, results = Correlation(first, second, 4), torch.get_num_threads(), []
    try:
        for count in (1, 2, 3):
            torch.set_num_threads(count)
            results.append(correlation(at))
    finally:
        torch.set_num_threads(threads)
    assert torch.equal(results[0], results[1]) and torch.equal(results[0], results[2])
    assert not results[0][0, :, 0, :6].any() and torch.isfinite(results[0]).all()
    assert torch.allclose(results[0], Correlation(first, second, 4, kernel=False)(at), atol=2e-5)


def test_products_do_not_depend_on_how_rows_are_blocked(monkeypatch: pytest.MonkeyPatch) -> None:
    g = torch.Generator().manual_seed(3)
    first, second = (torch.randn(1, 16, 8, 9, generator=g) for _ in range(2))
    at = torch.rand(1, 2, 8, 9, generator=g) * 9
    whole = Correlation(first, second, 2, kernel=False)(at)
    monkeypatch.setattr("e4dgs.vision.flow.raft.correlation.CHUNK_BYTES", 5 * 72 * 4)
    assert torch.allclose(Correlation(first, second, 2, kernel=False)(at), whole, atol=1e-6)


@BOTH
def test_encoders_are_convolutions_norms_and_shortcuts(a: Architecture) -> None:
    state = {name: value.double() for name, value in random_state(a).items()}
    x = torch.rand(1, 3, 64, 72, generator=torch.Generator().manual_seed(4), dtype=torch.float64) * 2 - 1

    def by_hand(encoder: str) -> Tensor:
        def norm(name: str, x: Tensor) -> Tensor:
            if encoder == "fnet":
                return (x - x.mean((2, 3), keepdim=True)) / (x.var((2, 3), keepdim=True, unbiased=False) + 1e-5).sqrt()
            if a.small:
                return x
            keys = ("running_mean", "running_var", "weight", "bias")
            return F.batch_norm(x, *(state[f"{encoder}.{name}.{key}"] for key in keys), eps=1e-5)

        def conv(name: str, x: Tensor, stride: int = 1) -> Tensor:
            weight = state[f"{encoder}.{name}.weight"]
            return F.conv2d(x, weight, state[f"{encoder}.{name}.bias"], stride, tuple(k // 2 for k in weight.shape[2:]))

        y = norm("norm1", conv("conv1", x, 2)).relu()
        for name, _, _, stride in blocks(a):
            z = y
            for k in (1, 2, 3) if a.small else (1, 2):
                z = norm(f"{name}.norm{k}", conv(f"{name}.conv{k}", z, stride if k == (2 if a.small else 1) else 1)).relu()
            y = z + (y if stride == 1 else norm(f"{name}.downsample.1", conv(f"{name}.downsample.0", y, stride)))
            y = y.relu()
        return conv("conv2", y)

    for encoder in ("fnet", "cnet"):
        found = encode(folded(state, a), encoder, a, x.clone())
        assert found.shape[2:] == (8, 9) and torch.allclose(found, by_hand(encoder), atol=1e-9), encoder


@BOTH
def test_one_update_is_a_gated_recurrent_unit(a: Architecture) -> None:
    state = {name: value.double() for name, value in random_state(a, 1).items()}
    g = torch.Generator().manual_seed(5)
    hidden, context, correlation, flow = (
        torch.randn(1, c, 6, 7, generator=g, dtype=torch.float64) for c in (a.state, a.context, a.window, 2)
    )
    hidden = hidden.tanh()

    def conv(name: str, x: Tensor) -> Tensor:
        weight = state[f"update_block.{name}.weight"]
        return F.conv2d(x, weight, state[f"update_block.{name}.bias"], 1, tuple(k // 2 for k in weight.shape[2:]))

    matched = conv("encoder.convc1", correlation).relu()
    if not a.small:
        matched = conv("encoder.convc2", matched).relu()
    moved = conv("encoder.convf2", conv("encoder.convf1", flow).relu()).relu()
    x = torch.cat([context, conv("encoder.conv", torch.cat([matched, moved], 1)).relu(), flow], 1)
    expected = hidden
    for k in [""] if a.small else ["1", "2"]:
        z, r = (torch.sigmoid(conv(f"gru.conv{gate}{k}", torch.cat([expected, x], 1))) for gate in "zr")
        q = torch.tanh(conv(f"gru.convq{k}", torch.cat([r * expected, x], 1)))
        expected = (1 - z) * expected + z * q
    change = conv("flow_head.conv2", conv("flow_head.conv1", expected).relu())
    kept = hidden.clone(), context.clone(), correlation.clone(), flow.clone()
    ready = folded(state, a)
    found = update(ready, a, hidden, context_terms(ready, a, context), correlation, flow)
    assert torch.allclose(found[0], expected, atol=1e-12) and torch.allclose(found[1], change, atol=1e-12)
    assert all(torch.equal(x, y) for x, y in zip(kept, (hidden, context, correlation, flow))), "an input was written to"


def test_each_fine_pixel_is_a_convex_combination_of_nine_features() -> None:
    state = random_state(BASIC, 2)
    g = torch.Generator().manual_seed(6)
    hidden, flow = torch.randn(1, 128, 4, 5, generator=g), torch.randn(1, 2, 4, 5, generator=g)
    fine = enlarge(state, BASIC, hidden, flow)
    logits = F.conv2d(hidden, state["update_block.mask.0.weight"], state["update_block.mask.0.bias"], padding=1).relu()
    logits = 0.25 * F.conv2d(logits, state["update_block.mask.2.weight"], state["update_block.mask.2.bias"])
    padded = F.pad(8 * flow, (1, 1, 1, 1))
    for y, x in ((0, 0), (13, 22), (31, 39), (17, 8)):
        i, j = y // 8, x // 8
        weights = logits[0].view(9, 8, 8, 4, 5)[:, y % 8, x % 8, i, j].softmax(0)
        expected = (weights * padded[0, :, i : i + 3, j : j + 3].reshape(2, 9)).sum(1)
        assert torch.allclose(fine[0, :, y, x], expected, atol=1e-5)


def test_the_small_network_enlarges_bilinearly() -> None:
    flow = torch.stack(torch.meshgrid(torch.arange(3.0), torch.arange(4.0), indexing="ij"))[None]
    fine = enlarge({}, SMALL, torch.empty(0), flow)
    assert torch.allclose(fine[0, 1, 5], 8 * torch.linspace(0, 3, 32), atol=1e-5)


@BOTH
@pytest.mark.parametrize("size", [(1, 1), (8, 8), (70, 65), (64, 128)])
def test_pictures_of_any_size_have_a_flow_of_theirs(a: Architecture, size: tuple[int, int]) -> None:
    net = Raft(random_state(a), a)
    first, second = (net.encode(picture(*size, seed)) for seed in range(2))
    flow, steps = net.match(first, second, iterations=2)
    assert flow.shape == (*size, 2) and flow.dtype == np.float32 and np.isfinite(flow).all() and steps == 2


@pytest.mark.parametrize(("tolerance", "steps"), [(0.0, 3), (3.999, 3), (4.001, 1)])
def test_it_stops_after_a_step_smaller_than_the_tolerance_and_not_before(
    monkeypatch: pytest.MonkeyPatch, tolerance: float, steps: int
) -> None:
    """Each step here moves every feature by (0.3, 0.4), which is 4 px."""
    step = torch.tensor([0.3, 0.4])[None, :, None, None].expand(1, 2, 8, 8)
    monkeypatch.setattr("e4dgs.vision.flow.raft.network.update", lambda state, a, hidden, *_: (hidden, step))
    net = Raft(random_state(SMALL), SMALL)
    features = net.encode(picture(64, 64))
    flow, taken = net.match(features, features, iterations=3, tolerance=tolerance)
    assert taken == steps and np.allclose(flow, steps * np.array([2.4, 3.2]), atol=1e-4)


def test_pictures_that_do_not_go_together_are_refused() -> None:
    net = Raft(random_state(SMALL), SMALL)
    with pytest.raises(ValueError, match=r"expected uint8 \[H, W, 3\]"):
        net.encode(np.full((8, 8, 3), np.nan))
    with pytest.raises(ValueError, match="differ in size"):
        net.match(net.encode(picture(8, 8)), net.encode(picture(8, 9)))
    with pytest.raises(ValueError, match="iterations"):
        net.match(net.encode(picture(8, 8)), net.encode(picture(8, 8)), iterations=0)


@BOTH
def test_the_file_says_which_network_it_is(a: Architecture, tmp_path: Path) -> None:
    state = random_state(a)
    counters = {f"{name}.num_batches_tracked": torch.tensor(3) for name in norms(a)}
    save_file({**state, **counters}, tmp_path / "a.safetensors")
    torch.save({f"module.{name}": value for name, value in state.items()}, tmp_path / "a.pth")
    for name in ("a.safetensors", "a.pth"):
        found, architecture = read_weights(tmp_path / name)
        assert architecture is ARCHITECTURES[a.name] and found.keys() == state.keys()
        assert all(torch.equal(found[key], state[key]) for key in state)


@BOTH
def test_torchvisions_names_are_understood(a: Architecture) -> None:
    state = random_state(a)
    theirs = {torchvisions(name, a.small): value for name, value in state.items()}
    assert len(theirs) == len(state) and ("feature_encoder.convnormrelu.0.weight" in theirs)
    found, architecture = recognise(theirs)
    assert architecture is a and all(torch.equal(found[name], state[name]) for name in state)


class Code:
    def __reduce__(self):
        return (print, ("this must never run",))


def test_files_that_are_not_weights_are_refused_by_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    state = random_state(SMALL)
    good = tmp_path / "good.safetensors"
    save_file(state, good)
    first = next(iter(state))

    def refused(name: str, words: str, content: object) -> None:
        path = tmp_path / name
        if isinstance(content, bytes):
            path.write_bytes(content)
        elif isinstance(content, dict):
            save_file(content, path)
        with pytest.raises(ValueError, match=words) as caught:
            Raft.load(path)
        assert name in str(caught.value)

    refused("missing.pth", "no such file", None)
    refused("cut.safetensors", "cannot be read", good.read_bytes()[:-1000])
    refused("empty.pth", "cannot be read", b"")
    refused("text.safetensors", "cannot be read", b"not weights at all" * 10)
    refused("code.pth", "more than tensors", pickle.dumps(Code(), protocol=2))
    refused("less.safetensors", "is missing", {k: v for k, v in state.items() if k != first})
    refused("shape.safetensors", "expected", {**state, first: torch.zeros(3)})
    refused("nan.safetensors", "not finite", {**state, first: torch.full_like(state[first], float("nan"))})
    refused("more.safetensors", "another network", {**state, "head.weight": torch.zeros(1)})
    refused("whole.safetensors", "not finite", {**state, first: torch.zeros(state[first].shape, dtype=torch.int32)})
    torch.save([1, 2], tmp_path / "list.pth")
    refused("list.pth", "tensors by name", None)
    assert "never run" not in capsys.readouterr().out
