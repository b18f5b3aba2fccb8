"""The container of binary glTF 2.0: arrays added one after another, and JSON that refers to them by number."""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping

import numpy as np

FLOAT, UNSIGNED_SHORT, UNSIGNED_INT = 5126, 5123, 5125  # component types of glTF 2.0
VERTICES, CORNERS = 34962, 34963  # buffer targets: vertex attributes, and vertex indices
MOST_BYTES = 2**32 - 1  # of a file, whose length is an unsigned number of 32 bits
JSON_CHUNK, BINARY_CHUNK = 0x4E4F534A, 0x004E4942


class Glb:
    """``number = file.add(array, FLOAT)`` for each accessor, then ``file.bytes(content)``."""

    def __init__(self) -> None:
        self._accessors: list[dict[str, object]] = []
        self._views: list[dict[str, int]] = []
        self._parts: list[bytes] = []
        self._offset = 0

    def add(self, array: np.ndarray, component: int, bounds: bool = False, normalized: bool = False, target: int | None = None) -> int:
        """Add ``array`` [n, 1..4], little-endian, and return the number of its accessor. A row must be a multiple of four bytes long.

        component: its component type. bounds: write minimum and maximum, which glTF requires for positions and key times. target:
        `VERTICES`, `CORNERS`, or None for animations."""
        array = np.ascontiguousarray(array)
        accessor: dict[str, object] = {
            "bufferView": len(self._views),
            "componentType": component,
            "count": len(array),
            "type": "SCALAR" if array.shape[1] == 1 else f"VEC{array.shape[1]}",
        }
        if normalized:
            accessor["normalized"] = True
        if bounds and len(array):
            accessor |= {"min": array.min(0).tolist(), "max": array.max(0).tolist()}
        view = {"buffer": 0, "byteOffset": self._offset, "byteLength": array.nbytes}
        self._views.append(view if target is None else view | {"target": target})
        self._accessors.append(accessor)
        self._parts.append(array.tobytes())
        self._offset += array.nbytes
        return len(self._accessors) - 1

    def bytes(self, content: Mapping[str, object]) -> bytes:
        """The file: the JSON ``content`` and the arrays it refers to. Raises ValueError if that is more than a .glb file can hold."""
        whole: dict[str, object] = {"asset": {"version": "2.0", "generator": "e4dgs"}, **content}
        if self._parts:
            whole |= {"accessors": self._accessors, "bufferViews": self._views, "buffers": [{"byteLength": self._offset}]}
        text = json.dumps(whole, separators=(",", ":"), allow_nan=False).encode()
        text += b" " * (-len(text) % 4)
        if (size := 12 + 8 + len(text) + 8 + self._offset) > MOST_BYTES:
            raise ValueError(f"it would take {size / 1e9:.2f} GB, and a .glb file holds {MOST_BYTES / 1e9:.2f} GB at most")
        binary = b"".join(self._parts)
        chunks = struct.pack("<II", len(text), JSON_CHUNK) + text
        if binary:
            chunks += struct.pack("<II", len(binary), BINARY_CHUNK) + binary
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks
