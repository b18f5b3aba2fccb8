"""`solve_turning`: finds the cameras when the camera turns but moves too little to triangulate from pairs. Uses only numpy.

The mapper starts from two images that see points under an angle. In a pan from a tripod, or by hand through a long lens, there are none,
and the mapper finds nothing, or cameras with absurd focal lengths. But turning determines the focal length, and rotations follow from
matches alone. The small motion of the camera is then found from all images together, if the pictures show it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from ..worker.lens import LONGEST, SHORTEST
from .bundle import Bundle, solve
from .tracks import join

RATIOS = tuple(np.geomspace(SHORTEST, LONGEST, 24))  # focal lengths tried, of the longer side
PAIRS = 24  # pairs of images, those whose matches move farthest, that the first search for the focal length uses
MATCHES = 40  # that a pair needs to give a rotation
FITS = 0.003  # of the longer side: limit for the median error of those pairs under rotations alone (2.6 px of 854), without lens and motion
ANYHOW = 0.02  # the same limit if the mapper did not get far: more motion than rotations explain, less than two images can determine
SOLVED = 0.0015  # of the longer side: limit for the median error of all observations at the end
MOST = 3000  # tracks
SOLVES = 3  # adjustments: of rotations, then motion, then the lens as well
MOVED = 0.75  # share of the median error under rotations that must remain at most for motion to be believed
SPAN = 0.1, 10.0  # times the median: limits of inverse distances, which are arbitrary for points seen under no angle
TOLD = 0.001  # of the longer side: least gap between the errors of the best and worst focal lengths for the pictures to determine one
UNTOLD = 1.2  # of the longer side: the focal length assumed if the pictures do not determine one


@dataclass(frozen=True)
class Turning:
    """frames [n] bool: which have a pose. bundle: all n frames and their tracks, adjusted. moved: whether camera motion was found."""

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
    tick: Callable[[], None] = lambda: None,
) -> Turning | None:
    """Cameras of images taken with one lens, from matches {(a, b): [M, 2]} between features at places [n] of [N, 2] px. focal: in px, if
    known; bent: whether the lens has a radial term; fits: `FITS` or `ANYHOW`; tick: called before each of at most `SOLVES` * `STEPS` steps.

    None if rotations do not explain the matches: the camera then moves, and the mapper should be used.
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
    turned = solve(start, move=False, lens=lens, tick=tick)
    if np.median(turned.errors()) > fits * side:
        return None
    bundle, moved = _moved(turned, lens, tick)
    if np.median(bundle.errors()) > SOLVED * side:
        return None
    return Turning(known, bundle, moved)


def _moved(turned: Bundle, lens: int, tick: Callable[[], None]) -> tuple[Bundle, bool]:
    """Adds the camera's motion if that explains the pictures better. Otherwise all points are put on a sphere, at the same distance."""
    flat = replace(turned, rho=np.ones(len(turned.rho)))
    moved = solve(solve(flat, move=True, lens=0, tick=tick), move=True, lens=lens, tick=tick)
    median = float(np.median(moved.rho))
    if median < 0:  # flipping the signs of both changes nothing in the pictures
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
    """Rotation [3, 3] from camera a to b and its median error, px, by Kabsch's method on rays; disagreeing matches get little weight."""
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
    """Rotations [n, 3, 3] along the pairs with most matches (a maximum spanning tree); known [n]: whether in the largest connected part."""
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
