"""Poses and camera matrices in small text files, and tables of poses, that hold what they should not."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from .captures import put
from .case import Case, cut, node, replace, sparse

MATRICES = {
    "empty": b"",
    "words": b"1 0 0 x",
    "three rows": b"1 0 0\n0 1 0\n0 0 1\n",
    "scaled": b"2 0 0 0 0 2 0 0 0 0 2 0 0 0 0 1",
    "mirrored": b"-1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1",
    "far": b"1 0 0 1e300 0 1 0 0 0 0 1 0 0 0 0 1",
    "no UTF-8": b"\xff\xfe\x00",
    "many digits": b"9" * 100_000,
    "long": b"1 " * 1_000_000,
}
LINES = {
    "rgb.txt": (b"", b"1.0\n", b"x rgb/0.png\n" * 4, b"1.0 ../../etc/passwd\n", b"1.0 /etc/passwd\n", b"nan rgb/0.png\n", b"\xff" * 9),
    "groundtruth.txt": (
        b"",
        b"1 2 3\n",
        b"a b c d e f g h\n",
        b"1 0 0 0 0 0 0 0\n2 0 0 0 0 0 0 0\n",
        b"0 1e300 0 0 0 0 0 1\n3 0 0 0 0 0 0 1\n",
    ),
}


def cases() -> Iterator[Case]:
    for what, text in MATRICES.items():
        yield Case(f"pose.txt: {what}", "rgbd", replace("frame-1.pose.txt", text), names=("frame-1.pose.txt",))
        yield Case(f"K.txt of a scan: {what}", "rgbd", replace("K.txt", text), names=() if what == "three rows" else ("K.txt",))
    for file, texts in LINES.items():
        for number, text in enumerate(texts):
            yield Case(f"{file}: {number}", "tum", replace(file, text), names=(file,))
        yield Case(f"{file}: a terabyte", "tum", sparse(file), names=(file,))
        yield Case(f"{file}: a pipe", "tum", node(file, "pipe"), names=())
    for layout, file in (("llff", "poses_bounds.npy"), ("multiview", "poses_bounds_multipleview.npy"), ("multiview", "sparse_/images.txt")):
        yield Case(f"{layout}: {file}: half", layout, cut(file, 0.5), names=())
        yield Case(f"{layout}: {file}: empty", layout, replace(file, b""), names=())
        yield Case(f"{layout}: {file}: a terabyte", layout, sparse(file), names=())
    yield Case("images.txt: lines of keypoints are images", "colmap_text", replace("sparse/0/images.txt", _bare(4)), names=())
    yield Case(
        "images.txt: a million of them", "colmap_text", replace("sparse/0/images.txt", _bare(100_000)), names=("sparse/0/images.txt",)
    )
    yield Case("a second model of nothing", "colmap_text", _second, names=())


def _second(root: Path) -> None:
    for part in ("cameras", "images"):
        put(root, f"sparse/1/{part}.txt", b"x")


def _bare(count: int) -> bytes:
    return "".join(f"{i + 1} 1 0 0 0 {0.1 * i} 0 0 1 {i}.png\n" for i in range(count)).encode()
