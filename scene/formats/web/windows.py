"""A scene in several files by time: one with what lives long, and one for each stretch of time with what is visible only then."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .container import unpack
from .scene import WebScene

SECONDS = 2.0  # of a window; what is visible for longer belongs to the first file
MOST = 1000  # windows
SHARED = ("motion", "corners", "sh_degree", "frames")  # fields that all files of a scene have in common
LEAST_ALPHA = 1 / 255
KINDS = (("g", "gaussians"), ("c", "convexes"))


def split(data: bytes) -> list[bytes]:
    """The file of a scene as several: the first, whose field `windows` says what the others hold, then those, in order of time.

    Only lives are split, and clips of at least two windows; else the file alone is returned. Every number stays as it is in ``data``.
    """
    _, coded = unpack(data)
    scene = WebScene.from_bytes(data)
    header = {k: v for k, v in scene.header.items() if k != "arrays"}
    count = int(min(header["seconds"] / SECONDS, header["frames"] - 1, MOST))
    if header["motion"] != "lives" or count < 2:
        return [data]
    steps = {name: np.array(one.step) for name, one in coded.items() if one.planes}
    last = max(header["frames"] - 1, 1)
    spans = {kind: visible(scene, kind) for kind, _ in KINDS}
    window_of = {}
    for kind, span in spans.items():
        middle = (span.sum(1) / 2 / last * count).astype(int).clip(0, count - 1)
        window_of[kind] = np.where(span[:, 1] - span[:, 0] <= last / count, middle, -1)
    parts, windows = [], []
    for k in range(count):
        chosen = {kind: np.nonzero(window == k)[0] for kind, window in window_of.items()}
        if not sum(map(len, chosen.values())):
            continue
        shown = np.concatenate([spans[kind][index] for kind, index in chosen.items()]) / last
        counts = [len(chosen[kind]) for kind, _ in KINDS]
        windows.append([float(shown[:, 0].min()), float(shown[:, 1].max()), *counts])
        parts.append(rows_of(scene, header | {"cameras": []}, chosen, still=False).to_bytes(steps))
    rest = {kind: np.nonzero(window < 0)[0] for kind, window in window_of.items()}
    first = rows_of(scene, header | {"windows": windows}, rest, still=True)
    return [first.to_bytes(steps), *parts]


def visible(scene: WebScene, kind: str) -> np.ndarray:
    """[moving, 2] first and last frame (fractional, within the clip) at which each moving primitive of ``kind`` can be seen."""
    life, opacity = scene.arrays[f"{kind}_life"][:, 0], scene.arrays[f"{kind}_opacity"][:, 0, 0]
    strength = np.maximum(opacity[len(opacity) - len(life) :] / LEAST_ALPHA, 1)
    reach = np.exp(life[:, 1]) * np.sqrt(2 * np.log(strength)) + 0.01  # rounding in the player
    return np.stack([life[:, 0] - reach, life[:, 0] + reach], 1).clip(0, max(scene.header["frames"] - 1, 1))


def rows_of(scene: WebScene, header: dict[str, Any], chosen: dict[str, np.ndarray], still: bool) -> WebScene:
    """The ``chosen`` moving primitives of each kind, after the still ones if ``still``."""
    arrays, counts = {}, {}
    for kind, name in KINDS:
        first = scene.header[name][0]
        counts[name] = [first if still else 0, len(chosen[kind])]
        whole = np.concatenate([np.arange(counts[name][0]), first + chosen[kind]])
        for key, values in scene.arrays.items():
            if key.startswith(f"{kind}_"):
                arrays[key] = values[chosen[kind] if key in (f"{kind}_life", f"{kind}_drift", f"{kind}_spin") else whole]
    return WebScene(header | counts, arrays)


def join(files: Sequence[bytes]) -> WebScene:
    """Inverse of `split`, up to the order of primitives. Raises ValueError that says which file is wrong."""
    scenes = []
    for k, data in enumerate(files):
        try:
            scenes.append(WebScene.from_bytes(data))
        except ValueError as error:
            raise ValueError(f"file {k} of the scene: {error}") from error
    first = scenes[0]
    windows = first.header.get("windows", [])
    if len(scenes) != len(windows) + 1:
        raise ValueError(f"the scene has {len(windows) + 1} files, and {len(scenes)} are given")
    for k, (scene, (_, _, *counts)) in enumerate(zip(scenes[1:], windows), 1):
        same = all(scene.header[name] == first.header[name] for name in SHARED)
        if not same or [scene.header[name] for _, name in KINDS] != [[0, n] for n in counts]:
            raise ValueError(f"file {k} of the scene belongs to another scene")
    total = {name: [first.header[name][0], sum(one.header[name][1] for one in scenes)] for _, name in KINDS}
    header = {k: v for k, v in first.header.items() if k not in ("windows", "arrays")} | total
    return WebScene(
        header, {name: np.concatenate([one.arrays[name] for one in scenes]) for name in first.arrays} if windows else first.arrays
    )


def file_of(first: Path, k: int) -> Path:
    """Where window ``k``, counted from 1, of the scene lies whose first file is ``first``; the page has the same rule."""
    return first.with_name(f"{first.stem}-{k}{first.suffix}")


def read(first: Path) -> WebScene:
    """The scene whose first file is ``first``, with all its windows beside it. Raises ValueError or OSError."""
    data = first.read_bytes()
    windows = WebScene.from_bytes(data).header.get("windows", [])
    return join([data, *(file_of(first, k).read_bytes() for k in range(1, len(windows) + 1))])
