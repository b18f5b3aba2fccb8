"""The kernels as programs. Each set of features has its own program, so a call pays only for the features it uses."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from .runtime import Program

HERE = Path(__file__).resolve().parent
CHANNELS = 8  # extras that one launch blends; more extras need more launches
SHORT_KEYS = 2**15 - 1  # with fewer tiles than this, tile numbers have 16 bits and sorting takes half the time


def program(name: str, **features: int) -> Program:
    """The program of the .cu file with this name in this folder, with these features."""
    return Program(HERE / f"{name}.cu", tuple(sorted((key.upper(), value) for key, value in features.items())))


def _mode(antialiased: bool) -> dict[str, int]:
    """The feature of the second mode; the programs of the classic mode do not have it."""
    return {"antialiased": 1} if antialiased else {}


@cache
def project_gaussians(degree: int, antialiased: bool = False) -> Program:
    """degree: degree of the SH, -1 if colours are given directly."""
    return program("project_gaussians", sh_degree=degree, **_mode(antialiased))


@cache
def project_convexes(points: int, degree: int, antialiased: bool = False) -> Program:
    return program("project_convexes", points=points, sh_degree=degree, **_mode(antialiased))


@cache
def tiles(points: int, key_bits: int) -> Program:
    """points: number of points of each convex, 0 if there are no convexes."""
    return program("tiles", points=points, key_bits=key_bits)


@cache
def sort(key_bytes: int) -> Program:
    """key_bytes: 2, 4 or 8."""
    return program("sort", key_bytes=key_bytes)


@cache
def blend_forward(points: int, extras: int) -> Program:
    return program("blend_forward", points=points, extras=extras)


@cache
def blend_backward(points: int, extras: int, depth: bool) -> Program:
    return program("blend_backward", points=points, extras=extras, depth=int(depth))


@cache
def backproject_gaussians(degree: int, camera: bool, antialiased: bool = False) -> Program:
    return program("backproject_gaussians", sh_degree=degree, camera=int(camera), **_mode(antialiased))


@cache
def backproject_convexes(points: int, degree: int, camera: bool, antialiased: bool = False) -> Program:
    return program("backproject_convexes", points=points, sh_degree=degree, camera=int(camera), **_mode(antialiased))


def needed(
    points: int = 0,
    degree: int = 3,
    extras: int = 0,
    depth: bool = False,
    camera: bool = False,
    backward: bool = True,
    antialiased: bool = False,
) -> list[Program]:
    """All programs needed to render such a scene. Use it to compile them in parallel before the first frame (`warm_up`)."""
    found = [project_gaussians(degree, antialiased), sort(8), sort(2), tiles(points, 16), blend_forward(points, min(extras, CHANNELS))]
    if points:
        found.append(project_convexes(points, degree, antialiased))
    if backward:
        found += [blend_backward(points, min(extras, CHANNELS), depth), backproject_gaussians(degree, camera, antialiased)]
        if points:
            found.append(backproject_convexes(points, degree, camera, antialiased))
    return found


ARCHITECTURES = ("sm_75", "sm_80", "sm_86", "sm_89", "sm_90")  # register counts and spills are recorded for these
# What CI compiles for every architecture: every file, with the features that need the fewest and the most registers.
RECORDED: dict[str, Program] = {
    str(one): one
    for one in (
        *needed(points=0, degree=0),
        *needed(points=0, degree=3, extras=2, depth=True, camera=True),
        *needed(points=6, degree=3, extras=2, depth=True),
        *needed(points=8, degree=3, extras=CHANNELS, depth=True, camera=True),
        *needed(points=6, degree=-1),
        *needed(points=6, degree=-1, antialiased=True),
        *needed(points=8, degree=3, extras=CHANNELS, depth=True, camera=True, antialiased=True),
        tiles(6, 32),
        sort(4),
    )
}
