"""Small damage to sound captures, as data: which file, what is done to it and where. Hypothesis draws it, the corpus keeps it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from hypothesis import strategies as st

from .captures import LAYOUTS, write

VALUES = (None, True, 0, -1, 1e-320, 1e308, 10**400, float("nan"), float("inf"), "", "x", "../x", "\0", "\ud800", [], [[1]], {}, {"a": 1})


def mutations() -> st.SearchStrategy[list[dict[str, Any]]]:
    """One to three steps. file: which of the capture's files, by a number; at, to: places in it, from 0 to 1."""
    place = st.floats(0, 1, exclude_max=True, width=32)
    step = st.fixed_dictionaries(
        {
            "file": st.integers(0, 40),
            "do": st.sampled_from(["flip", "write", "cut", "drop", "repeat", "json"]),
            "at": place,
            "to": place,
            "value": st.integers(0, 255),
        }
    )
    return st.lists(step, min_size=1, max_size=3)


def make(layout: str, steps: list[dict[str, Any]], sandbox: Path) -> Path:
    """Writes the damaged capture; the path to give to e4dgs."""
    assert layout in LAYOUTS
    capture = write(layout, sandbox / "capture")
    root = capture if capture.is_dir() else capture.parent
    for step in steps:
        # camera files and models first, and pictures, of which there are many alike, last
        files = sorted((p for p in root.rglob("*") if p.is_file()), key=lambda p: (p.suffix == ".png", p.name, p.as_posix()))
        files = [p for p in files if p.suffix != ".png"] + [p for p in files if p.suffix == ".png"][:1]
        _damage(files[step["file"] % len(files)], step)
    return capture


def _damage(file: Path, step: dict[str, Any]) -> None:
    data = bytearray(file.read_bytes())
    begin, end = sorted((int(step["at"] * len(data)), int(step["to"] * len(data))))
    value = step["value"]
    if step["do"] == "json" and file.suffix == ".json":
        document = _parsed(data)
        slots = list(_slots(document))
        if slots:
            node, key = slots[int(step["at"] * len(slots))]
            node[key] = VALUES[value % len(VALUES)]
            data = bytearray(json.dumps(document).encode())
    elif step["do"] == "flip" and data:
        data[min(begin, len(data) - 1)] ^= value or 1
    elif step["do"] == "write":
        data[begin : begin + 8] = (bytes([value]) * 8, b"\xff" * 8, bytes(8))[value % 3][: len(data) - begin]
    elif step["do"] == "cut":
        del data[begin:]
    elif step["do"] == "drop":
        del data[begin:end]
    elif step["do"] == "repeat":
        data[begin:begin] = data[begin:end]
    file.write_bytes(data)


def _parsed(data: bytearray) -> Any:
    try:
        return json.loads(data)
    except ValueError:  # an earlier step has broken it
        return None


def _slots(node: Any):
    """(container, key) of every value in a document."""
    for key, value in node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ():
        yield node, key
        yield from _slots(value)
