"""Packets that are decoded and never shown, such as the alternate reference frames of VP8 and VP9."""

from __future__ import annotations

from typing import Any


def is_hidden(codec: str, packet: Any) -> bool:
    """Whether the packet's own header says that it shows nothing. Sources: RFC 6386, section 9.1; the VP9 bitstream specification, 6.2."""
    if codec == "vp8":
        return not bytes(packet)[0] & 0x10
    if codec != "vp9":
        return False
    data = bytes(packet)
    if data[-1] & 0xE0 == 0xC0:  # a superframe, which ends in a frame that is shown
        return False
    bits = f"{data[0]:08b}"
    profile = int(bits[3] + bits[2], 2)
    at = 5 if profile == 3 else 4  # then: an existing frame is shown, kind of frame, this one is shown
    return bits[at] == "0" and bits[at + 2] == "0"


def may_be_empty(codec: str, size: int) -> bool:
    """Whether a packet is so small that it may be MPEG-4's "not coded", which repeats the last picture and gives none."""
    return codec in ("mpeg4", "msmpeg4v1", "msmpeg4v2", "msmpeg4v3", "h263") and size < 24
