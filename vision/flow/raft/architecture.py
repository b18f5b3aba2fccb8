"""The sizes of the two published RAFT networks, and every tensor that a weights file for them must hold."""

from __future__ import annotations

from dataclasses import dataclass

LEVELS = 4  # of the correlation pyramid, each half the size of the one before
STRIDE = 8  # px of the picture per feature


@dataclass(frozen=True)
class Architecture:
    """widths: channels of the encoders' stem and three stages. features: channels that are matched. state: channels of the recurrent unit's
    state. context: channels it reads at every step. radius: of the window looked up in each pyramid level. `small` decides the rest."""

    name: str
    widths: tuple[int, int, int, int]
    features: int
    state: int
    context: int
    radius: int
    small: bool

    @property
    def window(self) -> int:
        """Number of correlations that a pixel reads at every step."""
        return LEVELS * (2 * self.radius + 1) ** 2

    @property
    def motion(self) -> int:
        """Channels of the encoded motion, including the flow itself."""
        return 82 if self.small else 128


BASIC = Architecture("raft", (64, 64, 96, 128), 256, 128, 128, 4, small=False)
SMALL = Architecture("raft-small", (32, 32, 64, 96), 128, 96, 64, 3, small=True)
ARCHITECTURES = {a.name: a for a in (BASIC, SMALL)}


def blocks(a: Architecture) -> list[tuple[str, int, int, int]]:
    """Residual blocks of an encoder in order: name, channels in and out, stride."""
    found, before = [], a.widths[0]
    for stage, (width, stride) in enumerate(zip(a.widths[1:], (1, 2, 2)), 1):
        found += [(f"layer{stage}.0", before, width, stride), (f"layer{stage}.1", width, width, 1)]
        before = width
    return found


def passes(a: Architecture) -> tuple[str, ...]:
    """Names of the recurrent unit's passes: the basic one runs along rows, then along columns."""
    return ("",) if a.small else ("1", "2")


def _convolutions(a: Architecture) -> dict[str, tuple[int, int, int, int]]:
    """Weight shape [out, in, height, width] of every convolution by its name in the published files."""
    shapes: dict[str, tuple[int, int, int, int]] = {}
    for encoder, out in (("fnet", a.features), ("cnet", a.state + a.context)):
        shapes[f"{encoder}.conv1"] = (a.widths[0], 3, 7, 7)
        for name, inside, width, stride in blocks(a):
            at = f"{encoder}.{name}"
            if a.small:
                narrow = width // 4
                shapes |= {
                    f"{at}.conv1": (narrow, inside, 1, 1),
                    f"{at}.conv2": (narrow, narrow, 3, 3),
                    f"{at}.conv3": (width, narrow, 1, 1),
                }
            else:
                shapes |= {f"{at}.conv1": (width, inside, 3, 3), f"{at}.conv2": (width, width, 3, 3)}
            if stride > 1:
                shapes[f"{at}.downsample.0"] = (width, inside, 1, 1)
        shapes[f"{encoder}.conv2"] = (out, a.widths[3], 1, 1)
    at, joined = "update_block", a.state + a.context + a.motion
    if a.small:
        shapes |= {
            f"{at}.encoder.convc1": (96, a.window, 1, 1),
            f"{at}.encoder.convf1": (64, 2, 7, 7),
            f"{at}.encoder.convf2": (32, 64, 3, 3),
            f"{at}.encoder.conv": (a.motion - 2, 96 + 32, 3, 3),
        }
        shapes |= {f"{at}.gru.conv{gate}": (a.state, joined, 3, 3) for gate in "zrq"}
    else:
        shapes |= {
            f"{at}.encoder.convc1": (256, a.window, 1, 1),
            f"{at}.encoder.convc2": (192, 256, 3, 3),
            f"{at}.encoder.convf1": (128, 2, 7, 7),
            f"{at}.encoder.convf2": (64, 128, 3, 3),
            f"{at}.encoder.conv": (a.motion - 2, 192 + 64, 3, 3),
            f"{at}.mask.0": (256, a.state, 3, 3),
            f"{at}.mask.2": (STRIDE * STRIDE * 9, 256, 1, 1),
        }
        shapes |= {f"{at}.gru.conv{gate}{k}": (a.state, joined, *size) for gate in "zrq" for k, size in (("1", (1, 5)), ("2", (5, 1)))}
    shapes[f"{at}.flow_head.conv1"] = (128 if a.small else 256, a.state, 3, 3)
    shapes[f"{at}.flow_head.conv2"] = (2, 128 if a.small else 256, 3, 3)
    return shapes


def norms(a: Architecture) -> dict[str, str]:
    """Batch norms of the published files, each with the convolution before it. Only the basic network's context encoder has any."""
    if a.small:
        return {}
    found = {"cnet.norm1": "cnet.conv1"}
    for name, _, _, stride in blocks(a):
        found |= {f"cnet.{name}.norm{k}": f"cnet.{name}.conv{k}" for k in (1, 2)}
        if stride > 1:
            found[f"cnet.{name}.downsample.1"] = f"cnet.{name}.downsample.0"
    return found


def expected_shapes(a: Architecture) -> dict[str, tuple[int, ...]]:
    """Name and shape of every tensor of a weights file."""
    convolutions = _convolutions(a)
    shapes: dict[str, tuple[int, ...]] = {}
    for name, shape in convolutions.items():
        shapes |= {f"{name}.weight": shape, f"{name}.bias": shape[:1]}
    for norm, convolution in norms(a).items():
        shapes |= {f"{norm}.{part}": convolutions[convolution][:1] for part in ("weight", "bias", "running_mean", "running_var")}
    return shapes
