"""COLMAP models, arrays of numpy and point clouds whose heads promise what their files do not hold."""

from __future__ import annotations

import io
import struct
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from .case import Case, cut, node, patch, replace, sparse

PARTS = ("cameras", "images", "points3D")


def cases() -> Iterator[Case]:
    yield from _colmap_binary()
    yield from _colmap_text()
    yield from _arrays()
    yield from _clouds()


def _colmap_binary() -> Iterator[Case]:
    for part in PARTS:
        file = f"sparse/0/{part}.bin"
        for count in (0, 2, 10**9, 2**63, 2**64 - 1):
            yield Case(f"{file}: {count} of them", "colmap", _at(file, 0, struct.pack("<Q", count)), names=(file,))
        for share in (0.0, 0.3, 0.9):
            yield Case(f"{file}: {share:.0%} of it", "colmap", cut(file, share), names=(file,))
        yield Case(f"{file}: a terabyte of zeros", "colmap", sparse(file), names=(file,))
        yield Case(f"{file}: a terabyte of a billion", "colmap", sparse(file, head=struct.pack("<Q", 10**9)), names=(file,))
        yield Case(f"{file}: a pipe", "colmap", node(file, "pipe"), names=(file,))
    camera, image = "sparse/0/cameras.bin", "sparse/0/images.bin"
    for model in (-1, 7, 99, 2**31 - 1):
        yield Case(f"{camera}: model {model}", "colmap", _at(camera, 12, struct.pack("<i", model)), names=(camera,))
    yield Case(f"{camera}: 2^63 px", "colmap", _at(camera, 16, struct.pack("<Q", 2**63)), names=(camera,))
    yield Case(f"{camera}: 0 px", "colmap", _at(camera, 16, struct.pack("<Q", 0)), names=(camera,))
    for value in (float("nan"), float("inf"), -1.0, 0.0, 1e300):
        yield Case(f"{camera}: focal length {value}", "colmap", _at(camera, 32, struct.pack("<d", value)), names=(camera,))
        yield Case(f"{image}: quaternion {value}", "colmap", _at(image, 12, struct.pack("<d", value)), names=(image,))
        yield Case(f"{image}: translation {value}", "colmap", _at(image, 44, struct.pack("<d", value)), names=(image,))
        yield Case(
            f"points3D.bin: {value}", "colmap", _at("sparse/0/points3D.bin", 16, struct.pack("<d", value)), names=("sparse/0/points3D.bin",)
        )
    frame = struct.pack("<QII7dI", 1, 1, 1, 1, 0, 0, 0, 0, 0, 0, 2)
    frames = {
        "a billion": struct.pack("<Q", 10**9),
        "cut": frame + bytes(20),
        "of 2^32 pictures": frame[:-4] + b"\xff" * 4 + bytes(100),
    }
    file = "sparse/0/frames.bin"
    for what, content in frames.items():
        yield Case(f"{file}: {what}", "colmap", replace(file, content), names=(file,))
        yield Case(f"{file}: {what}, a terabyte", "colmap", sparse(file, head=content), names=() if what == "cut" else (file,))
    yield Case(f"{image}: 2^60 features", "colmap", patch(image, b"1.png\0", 6, struct.pack("<Q", 2**60)), names=(image,))
    yield Case(f"{image}: a name without an end", "colmap", _at(image, 72, b"x" * 2000), names=(image,))
    for what, name in {"control": b"\n\x1b.pg", "no UTF-8": b"\xff\xfe.pg", "up": b"../ab", "none": b"\0\0\0\0\0"}.items():
        yield Case(f"{image}: name: {what}", "colmap", patch(image, b"1.png\0", 0, name), names=(image,))


def _colmap_text() -> Iterator[Case]:
    images = "1 1 0 0 0 0 0 0 1 0.png\n\n"
    texts = {
        "cameras": (
            "1 PINHOLE 12 8 1e999 10 6 4",
            "1 PINHOLE 12 8",
            "9" * 5000 + " PINHOLE 12 8 10 10 6 4",
            "1 PINHOLE nan inf 10 10 6 4",
            "\xff",
        ),
        "images": (
            images + "\n\n",
            "1 nan 0 0 0 0 0 0 1 0.png\n",
            images * 2,
            "1 1 0 0 0 0 0 0 9 0.png\n",
            "x" * 100_000,
            "1 1 0 0 0 1e300 0 0 1 0.png",
        ),
        "points3D": ("1 0 0 inf 0 0 0 0", "1 0 0", "1 0 0 1e300 0 0 0 0", "1 a b c 0 0 0", "1 0 0 1 1e99 0 0 0\n" * 3),
    }
    for part, variants in texts.items():
        file = f"sparse/0/{part}.txt"
        for number, text in enumerate(variants):
            names = () if text.startswith(images) else (file,)  # a sound list, too short or of one picture twice
            yield Case(f"{part}.txt: {number}", "colmap_text", replace(file, text.encode("latin-1")), names=names)
        yield Case(f"{part}.txt: a terabyte", "colmap_text", sparse(file), names=(file,))


def _npy(array: np.ndarray, **options: bool) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, array, **options)
    return buffer.getvalue()


def _promising(header: str, version: bytes = b"\x01\x00") -> bytes:
    return b"\x93NUMPY" + version + struct.pack("<H", len(header)) + header.encode("latin-1") + bytes(100)


def _described(shape: str, kind: str = "'<f8'") -> bytes:
    return _promising(f"{{'descr': {kind}, 'fortran_order': False, 'shape': {shape}, }}\n")


class _Pickled:
    """Would write a file where it is unpickled."""

    def __reduce__(self) -> tuple[Callable, tuple]:
        return open, ("unpickled", "w")


def _arrays() -> Iterator[Case]:
    rows = np.ones((3, 17))
    contents = {
        "empty": b"",
        "text": b"no array",
        "pickled": _npy(np.array([_Pickled()], dtype=object), allow_pickle=True),
        "cut": _npy(rows)[:200],
        **{
            f"shape {shape}": _described(shape)
            for shape in ("(10**9, 17)", "(1000000000000, 17)", f"({2**63}, 17)", "(-3, 17)", "(3, 17.0)", "()")
        },
        **{
            f"type {kind}": _described("(3, 17)", kind)
            for kind in ("'O'", "'V1000000000'", "'U100000000'", "'<c16'", "[('a', 'O')]", "'M8[s]'")
        },
        "deep head": _promising("(" * 9000),
        "version 9": _promising("{}", b"\x09\x00"),
        "head without end": b"\x93NUMPY\x02\x00\xff\xff\xff\xff{",
        "NaN": _npy(rows * np.nan),
        "huge numbers": _npy(rows * 1e300),
        "no rows": _npy(rows[:0]),
        "of bool": _npy(rows > 0),
    }
    for layout, file in (("n3v", "poses_bounds.npy"), ("nerfies", "points.npy")):
        for what, content in contents.items():
            sized = content.replace(b", 17)", b", 3) ") if layout == "nerfies" else content
            yield Case(f"{file}: {what}", layout, replace(file, sized), names=(file,))
        yield Case(
            f"{file}: a terabyte",
            layout,
            sparse(file, head=_described("(10000000, 17)" if layout == "n3v" else "(90000000, 3)")),
            names=(file,),
        )
        yield Case(f"{file}: a pipe", layout, node(file, "pipe"), names=(file,))
    for what, content in contents.items():
        yield Case(
            f"init_pt_cld.npz: {what}",
            "panoptic",
            replace("init_pt_cld.npz", _npz(content.replace(b", 17)", b", 7) "))),
            names=("init_pt_cld.npz",),
        )
    yield Case("init_pt_cld.npz: no archive", "panoptic", replace("init_pt_cld.npz", b"PK\3\4"), names=("init_pt_cld.npz",))
    yield Case(
        "init_pt_cld.npz: another name", "panoptic", replace("init_pt_cld.npz", _npz(_npy(rows), "other.npy")), names=("init_pt_cld.npz",)
    )
    bomb = _described("(200000000, 7)", "'|u1'") + bytes(150_000_000)
    yield Case("init_pt_cld.npz: zeros", "panoptic", replace("init_pt_cld.npz", _npz(bomb)), names=("init_pt_cld.npz",))


def _npz(content: bytes, name: str = "data.npy") -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        archive.writestr(name, content)
    return buffer.getvalue()


def _clouds() -> Iterator[Case]:
    def ply(count: object, body: bytes = b"", order: str = "ascii", properties: str = "float x;float y;float z") -> bytes:
        lines = "".join(f"property {line}\n" for line in properties.split(";"))
        return f"ply\nformat {order} 1.0\nelement vertex {count}\n{lines}end_header\n".encode("latin-1") + body

    little = "binary_little_endian"
    contents = {
        **{f"{count} vertices": ply(count, b"1 2 3\n") for count in (10**9, 10**30, -1, "nan", "\xb2", 2)},
        **{f"{count} binary vertices": ply(count, bytes(24), little) for count in (3, 10**7, 2**63)},
        "no end of the head": b"ply\n" + b"comment\n" * 20_000,
        "an endless word": ply(2, b"1" * 1_000_000),
        "NaN": ply(1, b"nan inf 1\n"),
        "far": ply(1, b"1e300 0 0"),
        "words": ply(1, b"a b c"),
        "lists": ply(1, b"1 1", properties="list uchar float x;float y;float z"),
        "twice": ply(1, b"1 2 3 4", properties="float x;float x;float y;float z"),
        "types": ply(1, b"1 2 3", properties="quad x;float y;float z"),
        "thousands": ply(10**6, b"1 2 3", properties="float x;float y;float z;" + ";".join(f"uchar a{i}" for i in range(3000))),
        "no vertices": ply(0),
        "empty": b"",
        "no order": ply(1, b"1 2 3", order="morse"),
    }
    for what, content in contents.items():
        yield Case(f"cloud.ply: {what}", "nerfstudio", replace("cloud.ply", content), names=("cloud.ply",))
    yield Case("cloud.ply: a terabyte", "nerfstudio", sparse("cloud.ply", head=ply(10**9, b"", little)), names=("cloud.ply",))
    yield Case("cloud.ply: a terabyte of text", "nerfstudio", sparse("cloud.ply", head=ply(10**6, b"1 2 3\n")), names=("cloud.ply",))
    yield Case("cloud.ply: a terabyte behind its points", "nerfstudio", sparse("cloud.ply", head=ply(1, b"1 2 3\n")), names=("cloud.ply",))
    yield Case("cloud.ply: a pipe", "nerfstudio", node("cloud.ply", "pipe"), names=("cloud.ply",))


def _at(file: str, offset: int, content: bytes) -> Callable[[Path], None]:
    def damage(root: Path) -> None:
        data = bytearray((root / file).read_bytes())
        data[offset : offset + len(content)] = content
        (root / file).write_bytes(data)

    return damage
