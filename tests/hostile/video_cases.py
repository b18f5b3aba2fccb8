"""Videos that are cut short, lie about their length and size, or are lists of other files."""

from __future__ import annotations

import struct
from collections.abc import Iterator

from .captures import mp4, png
from .case import Case, cut, node, patch, replace, sparse

LIST = "#EXTM3U\n#EXT-X-TARGETDURATION:9\n#EXTINF:9,\n{}\n#EXT-X-ENDLIST\n"
CONTENTS: dict[str, bytes | str] = {
    "empty": b"",
    "text": "no video",
    "a picture": png(),
    "a list (HLS) of a file": LIST.format("other.mp4"),
    "a list (HLS) of an address": LIST.format("http://127.0.0.1:9/a.ts"),
    "a list (concat)": "ffconcat version 1.0\nfile other.mp4\nfile other.mp4\n",
    "a list (concat) from elsewhere": "ffconcat version 1.0\nfile /etc/hostname\n",
    "a list (DASH)": '<?xml version="1.0"?><MPD xmlns="urn:mpeg:dash:schema:mpd:2011"><BaseURL>http://127.0.0.1:9/</BaseURL></MPD>',
    "a stream (SDP)": "v=0\no=- 0 0 IN IP4 127.0.0.1\ns=x\nc=IN IP4 127.0.0.1\nt=0 0\nm=video 5004 RTP/AVP 96\na=rtpmap:96 H264/90000\n",
    "GIF of 65535 x 65535": b"GIF89a"
    + struct.pack("<HHBBB", 65535, 65535, 0, 0, 0)
    + b",\0\0\0\0"
    + struct.pack("<HHB", 65535, 65535, 0)
    + b"\2\1L\0;",
    "Matroska without end": b"\x1aE\xdf\xa3" + b"\xff" * 2000,
    "AVI of a billion frames": b"RIFF"
    + struct.pack("<I", 2**31)
    + b"AVI LIST"
    + struct.pack("<I", 200)
    + b"hdrlavih"
    + struct.pack("<I", 56)
    + b"\xff" * 56,
    "YUV of 65535 x 65535": b"YUV4MPEG2 W65535 H65535 F25:1 C420jpeg\nFRAME\n" + bytes(1000),
    "IVF of 2^32 frames": b"DKIF\0\0\x20\0VP90" + struct.pack("<HHIIII", 65535, 65535, 1, 1, 2**32 - 1, 0) + bytes(100),
    "random bytes of MPEG-TS": (b"G" + b"\x1f\xff\x10" + b"\xaa" * 184) * 50,
    "boxes in boxes": b"".join(struct.pack(">I4s", 8 * (400 - i), b"moov") for i in range(400)),
    "a box of 2^63 bytes": struct.pack(">I4sQ", 1, b"moov", 2**63) + mp4(),
    "three bytes of H.264": b"\0\0\1",
}
# box -> offset behind its name -> content
LIES: dict[str, tuple[bytes, int, bytes]] = {
    "a billion samples of one byte": (b"stsz", 8, struct.pack(">II", 1, 10**9)),
    "a billion samples": (b"stsz", 12, struct.pack(">I", 10**9)),
    "one sample more": (b"stsz", 12, struct.pack(">I", 7)),
    "2^32 times": (b"stts", 12, struct.pack(">I", 2**32 - 1)),
    "steps of 2^32": (b"stts", 16, struct.pack(">I", 2**32 - 1)),
    "no step": (b"stts", 16, struct.pack(">I", 0)),
    "a billion samples in a chunk": (b"stsc", 16, struct.pack(">I", 10**9)),
    "chunks behind the end": (b"stco", 12, struct.pack(">I", 2**31)),
    "no time scale": (b"mdhd", 16, struct.pack(">I", 0)),
    "a length of 2^32": (b"mdhd", 20, struct.pack(">I", 2**32 - 1)),
    "65535 x 65535 in its entry": (b"avc1", 28, struct.pack(">HH", 65535, 65535)),
    "65535 x 65535 in its track": (b"tkhd", 80, struct.pack(">II", 65535 << 16, 65535 << 16)),
    "0 x 0 in its entry": (b"avc1", 28, bytes(4)),
    "a matrix of zeros": (b"tkhd", 44, bytes(36)),
    "a matrix of large numbers": (b"tkhd", 44, b"\x7f" * 36),
    "an unknown codec": (b"avc1", 0, b"zzzz"),
    "broken parameters": (b"avcC", 8, b"\xff" * 20),
    "another track's kind": (b"hdlr", 12, b"soun"),
    "an edit of 2^32": (b"elst", 8, b"\xff" * 12),
    "an edit of nothing": (b"elst", 8, bytes(12)),
    "a million edits": (b"elst", 4, struct.pack(">I", 10**6)),
    "an edit behind the end": (b"elst", 8, struct.pack(">Ii", 1000, 2**31 - 1)),
    "a matrix that mirrors": (b"tkhd", 44, struct.pack(">9i", -(1 << 16), 0, 0, 0, 1 << 16, 0, 0, 0, 1 << 30)),
    "a matrix that maps all to a line": (b"tkhd", 44, struct.pack(">9i", 1 << 16, 1 << 16, 0, 1 << 16, 1 << 16, 0, 0, 0, 1 << 30)),
}


def cases() -> Iterator[Case]:
    for what, content in CONTENTS.items():
        yield Case(f"video: {what}", "video", _with_other(content), names=("clip.mp4",))
    for what, (box, offset, content) in LIES.items():
        yield Case(f"video: {what}", "video", patch("clip.mp4", box, offset, content), names=("clip.mp4",))
    for share in (0.05, 0.3, 0.5, 0.7, 0.9, 0.99):
        yield Case(f"video: {share:.0%} of it", "video", cut("clip.mp4", share), names=("clip.mp4",))
        yield Case(f"videos: {share:.0%} of one", "videos", cut("b.mp4", share), names=("b.mp4",))
    for step in range(10):
        yield Case(f"video: bytes changed from {step}/10 on", "video", _scratched(step / 10), names=("clip.mp4",))
    yield Case("video: a terabyte", "video", sparse("clip.mp4"), names=("clip.mp4",))
    yield Case("video: a terabyte behind a video", "video", sparse("clip.mp4", head=mp4()), names=("clip.mp4",))
    for kind in ("pipe", "folder", "/dev/zero", "clip.mp4"):
        yield Case(f"video: {kind}", "video", node("clip.mp4", kind), names=("clip.mp4",))
        yield Case(
            f"video: {kind}, given itself",
            "video",
            lambda root, kind=kind: node("clip.mp4", kind)(root) or root / "clip.mp4",
            names=("clip.mp4",),
        )
    yield Case("video: every 10^6th frame", "video", lambda root: None, ("--set", "frames.every=1000000"))


def _with_other(content: bytes | str):
    def damage(root):
        replace("clip.mp4", content)(root)
        (root.parent / "other.mp4").write_bytes(mp4())

    return damage


def _scratched(begin: float):
    def damage(root):
        data = bytearray((root / "clip.mp4").read_bytes())
        for at in range(int(begin * len(data)), len(data), 37):
            data[at] ^= 0x55
        (root / "clip.mp4").write_bytes(data)

    return damage
