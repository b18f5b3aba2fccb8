"""What is rendered of primitives, in plain torch, for the tests of its kernels on the CPU and on the GPU."""

import torch
from e4dgs.scene.primitives import SH_C0

LIMIT = 2e-6  # of the largest number of each result
OUTPUTS = ("sizes", "opacities", "sh")


def given(n, stored=15, light=True, convex=False):
    """Named float32 inputs. Opacities reach close to 0 and 1."""
    draw = torch.Generator().manual_seed(5)

    def normal(*shape):
        return torch.randn(*shape, generator=draw)

    inputs = {"logs": normal(n) if convex else normal(n, 3), "logits": 5 * normal(n), "dc": normal(n, 1, 3), "rest": normal(n, stored, 3)}
    inputs |= {"others": normal(n)} if convex else {}
    return inputs | {"shades": normal(n, 3)} | ({"light": normal(3)} if light else {})


def composed(logs, logits, dc, rest, shown, shades, light):
    if light is not None:
        dc = dc + (shades @ light)[:, None, None] * (dc + 0.5 / SH_C0)
    return tuple(p.exp() for p in logs), logits.sigmoid(), torch.cat([dc, rest[:, :shown]], 1)


def outcome(run, inputs, shown, used=OUTPUTS):
    """Outputs, and the gradients of a sum of those in ``used`` with fixed weights; None of those that get none."""
    leaves = {name: p.detach().clone().requires_grad_() for name, p in inputs.items()}
    logs = tuple(leaves[name] for name in ("logs", "others") if name in leaves)
    rest = leaves["rest"], shown, leaves["shades"], leaves.get("light")
    sizes, opacities, sh = run(logs, leaves["logits"], leaves["dc"], *rest)
    outputs = {"opacities": opacities, "sh": sh, **{f"sizes{k}": p for k, p in enumerate(sizes)}}
    draw = torch.Generator().manual_seed(6)
    weights = {name: torch.randn(p.shape, generator=draw).to(p) for name, p in outputs.items()}
    chosen = [name for name in outputs if name.startswith(used)]
    found = torch.autograd.grad([outputs[k] for k in chosen], list(leaves.values()), [weights[k] for k in chosen], allow_unused=True)
    return {name: p.detach() for name, p in outputs.items()} | {f"g_{name}": g for name, g in zip(leaves, found)}


def exactly(inputs, shown, used=OUTPUTS):
    return outcome(composed, {name: p.double() for name, p in inputs.items()}, shown, used)


def assert_close(found, expected):
    assert found.keys() == expected.keys()
    for name, value in expected.items():
        if found[name] is None:
            assert value is None or not value.any(), name
            continue
        assert found[name].shape == value.shape and found[name].dtype == torch.float32, name
        if value.numel():
            assert float((found[name].double() - value).abs().max()) <= LIMIT * float(value.abs().max()), name
