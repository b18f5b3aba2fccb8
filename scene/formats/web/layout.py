"""Which arrays a scene of the web player has, and of which shapes: what readers hold a file to before they use it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

MOTIONS = ("static", "lives", "nodes", "paths")
LINKS = 4  # nodes that carry a point
MOST = 1 << 24  # primitives, nodes, keys or frames
NEAR = 1e-12, 1e12  # world units
RIGID = 1e-3  # how far rows of a camera's rotation may be from unit length and right angles


def shapes_of(header: Mapping[str, Any]) -> dict[str, tuple[int, int, int]]:
    """The shape of every array of a scene with this ``header``, by name. docs/player.md says what each holds."""
    gaussians, convexes, corners = sum(header["gaussians"]), sum(header["convexes"]), header["corners"]
    moving, bending, keys, nodes = header["gaussians"][1], header["convexes"][1], header["keys"], header["nodes"]
    shapes = {"g_means": (gaussians, 1, 3), "g_turns": (gaussians, 1, 3), "g_scales": (gaussians, 1, 3)}
    shapes |= {"c_points": (convexes, corners, 3), "c_shape": (convexes, 1, 2)}
    for kind, count in (("g", gaussians), ("c", convexes)):
        shapes |= {f"{kind}_opacity": (count, 1, 1), f"{kind}_color": (count, 1, 3)}
        shapes |= {f"{kind}_sh{d}": (count, 1, 3 * (2 * d + 1)) for d in range(1, header["sh_degree"] + 1)}
        if header["light"]:
            shapes[f"{kind}_shades"] = (count, 1, 3)
    if header["light"]:
        shapes["light"] = (keys, 1, 3)
    if header["motion"] == "lives":
        for kind, count in (("g", moving), ("c", bending)):
            shapes |= {f"{kind}_life": (count, 1, 2), f"{kind}_drift": (count, 1, 3), f"{kind}_spin": (count, 1, 3)}
    elif header["motion"] == "nodes":
        shapes |= {"node_homes": (nodes, 1, 3), "node_modes": (header["modes"], nodes, 7), "node_courses": (keys, 1, header["modes"])}
        shapes |= {"g_links": (moving, 1, LINKS), "g_weights": (moving, 1, LINKS - 1)}
        shapes |= {"c_links": (bending, corners, LINKS), "c_weights": (bending, corners, LINKS - 1)}
    elif header["motion"] == "paths":
        shapes |= {"g_path_means": (keys, moving, 3), "g_path_turns": (keys, moving, 4), "g_path_scales": (keys, moving, 3)}
        shapes["c_path_points"] = (keys, bending * corners, 3)
    return shapes


def check_header(header: Mapping[str, Any]) -> None:
    """Raises ValueError if ``header`` lacks a field or holds an impossible one."""
    for name, length in (("background", 3), ("up", 3), ("target", 3)):
        wanted = isinstance(header.get(name), list) and len(header[name]) == length and all(map(finite, header[name]))
        expect(wanted, name, header)
    for name in ("gaussians", "convexes"):
        expect(isinstance(header.get(name), list) and len(header[name]) == 2 and all(whole(k) for k in header[name]), name, header)
    for name, most in (("corners", 8), ("sh_degree", 3), ("frames", MOST), ("keys", MOST), ("nodes", MOST), ("modes", 4096)):
        expect(whole(header.get(name)) and header[name] <= most, name, header)
    expect(header.get("motion") in MOTIONS, "motion", header)
    expect(not sum(header["convexes"]) or header["corners"] >= 3, "corners", header)
    expect(header["motion"] not in ("nodes", "paths") or header["keys"] >= 1, "keys", header)
    expect(header["frames"] >= 1, "frames", header)
    for name in ("light", "antialiased"):
        expect(isinstance(header.get(name), bool), name, header)
    expect(not header["light"] or header["motion"] == "nodes", "light", header)
    expect(finite(header.get("near")) and NEAR[0] <= header["near"] <= NEAR[1], "near", header)
    expect(finite(header.get("seconds")) and header["seconds"] >= 0, "seconds", header)
    expect(isinstance(header.get("cameras"), list) and len(header["cameras"]) <= 10_000, "cameras", header)
    windows = header.get("windows", [])
    expect(isinstance(windows, list) and len(windows) <= 10_000 and (not windows or header["motion"] == "lives"), "windows", header)
    for one in windows:
        expect(isinstance(one, list) and len(one) == 4 and all(map(finite, one[:2])) and all(map(whole, one[2:])), "windows", header)
    for camera in header["cameras"]:
        numbers = isinstance(camera, dict) and all(finite(camera.get(key)) for key in ("time", "width", "height"))
        rows = numbers and all(
            isinstance(camera.get(key), list) and len(camera[key]) == n and all(map(finite, camera[key]))
            for key, n in (("cam_from_world", 16), ("K", 9))
        )
        expect(rows and isinstance(camera.get("name"), str), "cameras", header)
        expect(
            min(camera["width"], camera["height"], camera["K"][0], camera["K"][4]) > 0 and rigid(camera["cam_from_world"]),
            "cameras",
            header,
        )


def rigid(pose: list[float]) -> bool:
    """Whether 16 numbers, row by row, are a rotation and a shift."""
    x, y, z = pose[0:3], pose[4:7], pose[8:11]
    turned = [x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]]
    pairs = ((x, x, 1), (y, y, 1), (z, z, 1), (x, y, 0), (turned, z, 1))
    off = [sum(a * b for a, b in zip(one, other)) - wanted for one, other, wanted in pairs]
    off += [*pose[12:15], pose[15] - 1]
    return all(abs(one) <= RIGID for one in off)


def whole(value: object) -> bool:
    return type(value) is int and 0 <= value <= MOST


def finite(value: object) -> bool:
    return type(value) in (int, float) and math.isfinite(value)  # type: ignore[arg-type]


def expect(condition: bool, name: str, header: Mapping[str, Any]) -> None:
    if not condition:
        raise ValueError(f"its field {name} is {str(header.get(name))[:80]}")
