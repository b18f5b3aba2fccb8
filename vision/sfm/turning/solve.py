"""`solve_turning`: cameras of a capture whose camera turns, and moves too little to be triangulated by pairs. numpy alone.

The mapper begins with two images that see points under an angle. Where none do, a pan from a tripod or by hand through a long lens, it
finds nothing, or cameras with absurd focal lengths. Turning tells the focal length all the same, and rotations follow from matches alone.
What little the camera moved is found afterwards, by all images together, where the pictures tell it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ..worker.lens import LONGEST, SHORTEST
from .bundle import Bundle, solve
from .tracks import join

RATIOS = tuple(np.geomspace(SHORTEST, LONGEST, 24))  # focal lengths, of the longer side
PAIRS = 24  # pairs of images with the longest ways that the focal length is first looked for in
MATCHES = 40  # of a pair that gives a rotation
FITS = 0.003  # of the longer side: median error of those pairs under rotations alone (2.6 px of 854), before lens and small motion
ANYHOW = 0.02  # the same where the mapper did not get far: more motion than rotations explain, less than two images can tell
SOLVED = 0.0015  # of the longer side: median error of all observations at the end
MOST = 3000  # tracks
MOVED = 0.75  # of the median error under rotations, which motion must bring it below, to be believed
SPAN = 0.1, 10.0  # inverse distances that are kept, of the median: those of points under no angle are anything
TOLD = 0.001  # of the longer side: error between the best and the worst focal length tried, for one to be told
UNTOLD = 1.2  # of the longer side: the focal length taken where none is told


@dataclass(frozen=True)
class Turning:
    """frames [n] bool: which are posed. bundle: of all n frames and its tracks, adjusted. moved: whether motion was found."""

    frames: np.ndarray
    bundle: Bundle
    moved: bool


def solve_turning(
    matches: Mapping[tuple[int, int], np.ndarray],
    places: list[np.ndarray],
    width: int,
    height: int,
    focal: float | None = None,
    bent: bool = True,
    fits: float = FITS,
) -> Turning | None:
    """Cameras of images of one lens, from matches {(a, b): [M, 2]} between features at places [n] of [N, 2] px; focal: in px where known;
    bent: whether the lens has a radial term; fits: `FITS` or `ANYHOW`.

    None where rotations do not explain the matches: the camera moves, and the mapper's way is the right one.
    """
    side, centre = max(width, height), np.array([width / 2, height / 2])
    usable = {pair: m for pair, m in matches.items() if len(m) >= MATCHES}
    if not usable:
        return None
    ways = {p: float(np.median(np.linalg.norm(places[p[0]][m[:, 0]] - places[p[1]][m[:, 1]], axis=1))) for p, m in usable.items()}
    wide = sorted(ways, key=lambda p: -ways[p])[:PAIRS]
    tried = [focal] if focal else [ratio * side for ratio in RATIOS]
    errors = [np.median([_rotation(usable[p], places, p, f, centre)[1] for p in wide]) for f in tried]
    best = int(np.argmin(errors))
    if errors[best] > fits * side:
        return None
    found, lens = tried[best], 2 if bent else 1
    if len(tried) > 1 and errors[int(np.argmax(errors))] - errors[best] < TOLD * side:
        found, lens = UNTOLD * side, 0
    R, known = _chain(usable, places, found, centre)
    if known.sum() < 3:
        return None
    tracks = join(usable, places, MOST)
    keep = known[tracks.frame]
    if not keep.any():
        return None
    frame, xy = tracks.frame[keep], tracks.xy[keep]
    _, track = np.unique(tracks.track[keep], return_inverse=True)
    rays = np.einsum("oji,oj->oi", R[frame], _rays(xy, found, centre))
    d = np.zeros((track.max() + 1, 3))
    np.add.at(d, track, rays)
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    start = Bundle(R, np.zeros((len(places), 3)), d, np.zeros(len(d)), found, 0.0, centre, frame, track, xy)
    turned = solve(start, move=False, lens=lens)
    if np.median(turned.errors()) > fits * side:
        return None
    bundle, moved = _moved(turned, lens)
    if np.median(bundle.errors()) > SOLVED * side:
        return None
    return Turning(known, bundle, moved)


def _moved(turned: Bundle, lens: int) -> tuple[Bundle, bool]:
    """With what the camera moved, where that explains the pictures better; else on a sphere, the same distance for all."""
    flat = replace(turned, rho=np.ones(len(turned.rho)))
    moved = solve(solve(flat, move=True, lens=0), move=True, lens=lens)
    median = float(np.median(moved.rho))
    if median < 0:  # the signs of both change nothing in the pictures
        moved, median = replace(moved, rho=-moved.rho, t=-moved.t), -median
    low, high = SPAN
    moved = replace(moved, rho=np.clip(moved.rho / max(median, 1e-12), low, high), t=moved.t * median)
    better = np.median(moved.errors()) < MOVED * np.median(flat.errors())
    return (moved, True) if better else (flat, False)


def _rays(xy: np.ndarray, focal: float, centre: np.ndarray) -> np.ndarray:
    rays = np.concatenate([(xy - centre) / focal, np.ones((len(xy), 1))], axis=1)
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))


def _rotation(
    match: np.ndarray, places: list[np.ndarray], pair: tuple[int, int], focal: float, centre: np.ndarray
) -> tuple[np.ndarray, float]:
    """Rotation [3, 3] from camera a to b and its median error, px: Kabsch on rays, matches that disagree counting for little."""
    second = places[pair[1]][match[:, 1]]
    a, b = _rays(places[pair[0]][match[:, 0]], focal, centre), _rays(second, focal, centre)
    weight, R, error = np.ones(len(a)), np.eye(3), np.zeros(len(a))
    for _ in range(8):
        u, _, vt = np.linalg.svd((b * weight[:, None]).T @ a)
        R = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
        seen = a @ R.T
        error = np.linalg.norm(focal * seen[:, :2] / np.maximum(seen[:, 2:], 1e-6) + centre - second, axis=1)
        weight = 1 / (1 + (error / (np.median(error) + 0.05)) ** 2)
    return R, float(np.median(error))


def _chain(
    usable: Mapping[tuple[int, int], np.ndarray], places: list[np.ndarray], focal: float, centre: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Rotations [n, 3, 3] along the pairs with the most matches (a greatest spanning tree), and which are known [n]: the largest part."""
    parts = list(range(len(places)))

    def part(i: int) -> int:
        while parts[i] != i:
            i = parts[i]
        return i

    links: dict[int, list[tuple[int, np.ndarray]]] = {i: [] for i in range(len(places))}
    for a, b in sorted(usable, key=lambda p: (-len(usable[p]), p)):
        if part(a) != part(b):
            parts[part(b)] = part(a)
            R, _ = _rotation(usable[a, b], places, (a, b), focal, centre)
            links[a].append((b, R))
            links[b].append((a, R.T))
    labels = np.array([part(i) for i in range(len(places))])
    known = labels == np.bincount(labels).argmax()
    start = int(np.flatnonzero(known)[known.sum() // 2])
    rotations, queue, reached = np.tile(np.eye(3), (len(places), 1, 1)), [start], {start}
    while queue:
        i = queue.pop()
        for j, R in links[i]:
            if j not in reached:
                rotations[j] = R @ rotations[i]
                reached.add(j)
                queue.append(j)
    return rotations, known
