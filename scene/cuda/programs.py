"""The scene's kernels as programs, one for each set of compile-time features."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from ...rasterizer.cuda.runtime import Program

HERE = Path(__file__).resolve().parent


@cache
def program(name: str, **features: int) -> Program:
    """The .cu file ``name`` in this folder, compiled with these features; the same object on each call."""
    return Program(HERE / f"{name}.cu", tuple(sorted((key.upper(), value) for key, value in features.items())))


# The programs that CI compiles for every architecture.
RECORDED: dict[str, Program] = {
    str(one): one
    for one in (
        program("adam"),
        program("photometric"),
        program("displace"),
        program("lives"),
        program("looks"),
        program("smoothness"),
        program("sum_links"),
        *(program(name, links=k, hyper=h) for name in ("nearest", "skinning") for k, h in ((4, 2), (8, 4))),
        *(program("field", channels=c, levels=l) for c, l in ((16, 2), (64, 4))),
        *(program("field_backward", channels=c, levels=l, lines=n) for c, l, n in ((16, 2, 576), (16, 2, 0), (4, 1, 2496), (64, 4, 0))),
    )
}
