"""Pictures that are no pictures, that promise sizes which nobody has, or that other programs would be asked to draw."""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Iterator

from PIL import Image

from .captures import png
from .case import Case, cut, node, replace, sparse


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def _png(width: int, height: int, data: bytes = b"", extra: bytes = b"", bits: int = 8, colour: int = 2) -> bytes:
    head = _chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + head + extra + _chunk(b"IDAT", zlib.compress(data)) + _chunk(b"IEND", b"")


def _tiff(*entries: tuple[int, int, int, int], next_ifd: int = 0) -> bytes:
    """tag, type, count, value of each entry."""
    body = b"".join(struct.pack("<HHII", *entry) for entry in entries)
    return b"II*\0" + struct.pack("<IH", 8, len(entries)) + body + struct.pack("<I", next_ifd)


def _saved(kind: str, **options: object) -> bytes:
    buffer = io.BytesIO()
    Image.new("RGB", (12, 8)).save(buffer, kind, **options)
    return buffer.getvalue()


def _jpeg(width: int, height: int) -> bytes:
    data = bytearray(_saved("JPEG"))
    at = data.index(b"\xff\xc0")
    data[at + 5 : at + 9] = struct.pack(">HH", height, width)
    return bytes(data)


_SIZE = ((256, 4, 1, 12), (257, 4, 1, 8))
EXR = b"v/1\x01\x02\0\0\0dataWindow\0box2i\0" + struct.pack("<i4i", 16, 0, 0, 2**30, 2**30) + b"\0"
CONTENTS: dict[str, bytes] = {
    "empty": b"",
    "text": b"this is no picture",
    "PNG of 100000 x 100000": _png(100_000, 100_000),
    "PNG of 2^31 x 1": _png(2**31 - 1, 1),
    "PNG of 13000 x 13000 without pixels": _png(13_000, 13_000),
    "PNG of no size": _png(0, 0),
    "PNG of no height": _png(12, 0),
    "PNG bomb": _png(6_000, 6_000, bytes(751 * 6_000), bits=1, colour=0),
    "PNG with a text of 200 MB": _png(12, 8, bytes(37 * 8), _chunk(b"zTXt", b"a\0\0" + zlib.compress(bytes(200_000_000), 1))),
    "PNG with a profile of 200 MB": _png(12, 8, bytes(37 * 8), _chunk(b"iCCP", b"a\0\0" + zlib.compress(bytes(200_000_000), 1))),
    "PNG of 2^31 moving pictures": _png(12, 8, bytes(37 * 8), _chunk(b"acTL", struct.pack(">II", 2**31 - 1, 0))),
    "PNG with a wrong checksum": png()[:-20] + b"XXXX" + png()[-16:],
    "PNG with broken EXIF": _png(12, 8, bytes(37 * 8), _chunk(b"eXIf", b"II*\0\xff\xff\xff\xff")),
    "PNG of floats": _png(12, 8, bytes(10), bits=32),
    "JPEG of 65500 x 65500": _jpeg(65_500, 65_500),
    "JPEG of 7000 x 7000": _jpeg(7_000, 7_000),
    "JPEG of no height": _jpeg(12, 0),
    "JPEG with broken EXIF": _saved("JPEG", exif=b"Exif\0\0II*\0\x08\0\0\0\xff\xff" + b"\xff" * 40),
    "TIFF of 2^31 x 2^31": _tiff((256, 4, 1, 2**31), (257, 4, 1, 2**31), (258, 3, 1, 8), (273, 4, 1, 8)),
    "TIFF of 2^32 tags": _tiff(*_SIZE, (258, 3, 2**32 - 1, 8), (273, 4, 2**32 - 1, 8)),
    "TIFF that leads to itself": _tiff(*_SIZE, next_ifd=8),
    "TIFF of no size": _tiff((256, 4, 1, 0), (257, 4, 1, 0), (258, 3, 1, 8), (262, 3, 1, 1), (273, 4, 1, 8)),
    "TIFF of an unknown compression": _tiff(*_SIZE, (258, 3, 1, 8), (259, 3, 1, 999), (262, 3, 1, 1), (273, 4, 1, 8)),
    "BMP of 2^31 x 2^31": b"BM" + struct.pack("<IIIIiiHHIIiiII", 54, 0, 54, 40, 2**31 - 1, -(2**31), 1, 24, 0, 0, 0, 0, 0, 0),
    "WebP of 16383 x 16383": b"RIFF"
    + struct.pack("<I", 30)
    + b"WEBPVP8X"
    + struct.pack("<I", 10)
    + b"\0\0\0\0"
    + b"\xfe\x3f\0" * 2
    + bytes(12),
    "EXR of 2^30 x 2^30": EXR,
    "EPS": b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 12 8\n%%EndComments\n(x) run\nshowpage\n",
    "GIF": _saved("GIF"),
    "SVG": b'<svg xmlns="http://www.w3.org/2000/svg" width="1e9" height="1e9"/>',
    "PPM of a number without end": b"P6 " + b"9" * 100_000,
    "ICNS": b"icns" + struct.pack(">I", 2**31) + b"ic10" + struct.pack(">I", 2**31),
    "FITS": b"SIMPLE  =                    T" + b" " * 50 + b"NAXIS1  = 99999999999999999999" + b" " * 3000,
}


def cases() -> Iterator[Case]:
    for what, content in CONTENTS.items():
        yield Case(f"picture: {what}", "images", replace("1.png", content), names=("1.png",))
    for share in (0.1, 0.5, 0.9):
        yield Case(f"picture: {share:.0%} of it", "images", cut("1.png", share), names=("1.png",))
    yield Case("picture: a terabyte", "images", sparse("1.png"), names=("1.png",))
    yield Case("picture: a terabyte behind it", "images", sparse("1.png", head=png()), names=("1.png",))
    yield Case("picture: a terabyte behind a head", "images", sparse("1.png", head=png()[:40]), names=("1.png",))
    for layout, file in (("images", "1.png"), ("n3v", "cam01/1.png"), ("panoptic", "ims/1/1.png"), ("nerfstudio", "1.png")):
        for kind in ("pipe", "folder", "/dev/zero", "/dev/stdin", file.rsplit("/", 1)[-1], "../nowhere.png"):
            yield Case(f"picture: {kind} as {file} of {layout}", layout, node(file, kind), names=(file,))
    for what in ("PNG of 100000 x 100000", "PNG of no size", "text", "JPEG of no height"):
        yield Case(f"mask: {what}", "panoptic", replace("seg/1/1.png", CONTENTS[what]), names=("seg/1/1.png",))
        yield Case(f"mask of what counts: {what}", "colmap_text", replace("masks/1.png", CONTENTS[what]), names=("masks/1.png",))
    yield Case("mask of what counts: black", "colmap_text", replace("masks/1.png", _saved("PNG")), names=("masks/1.png",))
    yield Case(
        "mask of what counts: a pipe",
        "colmap_text",
        lambda root: (root / "masks").mkdir() or node("masks/1.png", "pipe")(root),
        names=("masks/1.png",),
    )
    for what, text in {
        "NaN": "nan " * 9,
        "far": "1e300 " * 9,
        "zeros": "0 " * 9,
        "words": "a b c",
        "empty": "",
        "negative": "-1 " * 9,
    }.items():
        yield Case(f"K.txt: {what}", "images", replace("K.txt", text), names=("K.txt",))
    yield Case("K.txt: a terabyte", "images", sparse("K.txt"), names=("K.txt",))
    yield Case("K.txt: no UTF-8", "images", replace("K.txt", b"\xff\xfe"), names=("K.txt",))
