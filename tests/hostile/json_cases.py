"""Camera files in JSON that are broken, deep, huge, or hold what no camera file should."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from .captures import put
from .case import Case, node, replace, sparse

FILES = {
    "nerfstudio": "transforms.json",
    "dnerf": "transforms_train.json",
    "panoptic": "train_meta.json",
    "nerfies": "dataset.json",
    "nerfies:metadata": "metadata.json",
    "nerfies:scene": "scene.json",
    "nerfies:camera": "camera/001.json",
    "record3d": "metadata.json",
    "polycam": "keyframes/cameras/1.json",
}
TEXTS: dict[str, bytes] = {
    "empty": b"",
    "cut": b'{"frames": [{"file_path": "0.pn',
    "no UTF-8": b'{"frames": "\xff\xfe"}',
    "a list": b"[1, 2]",
    "a number": b"NaN",
    "deep lists": b'{"frames": ' + b"[" * 100_000 + b"]" * 100_000 + b"}",
    "deep objects": b'{"a":' * 100_000,
    "many digits": b'{"frames": ' + b"9" * 100_000 + b"}",
    "a name twice": b'{"frames": [], "frames": []}',
    "millions of lists": b'{"frames": [' + b"[]," * 1_000_000 + b"[]]}",
    "zeros": bytes(1000),
}
VALUES: dict[str, Any] = {
    "NaN": float("nan"),
    "Infinity": float("-inf"),
    "1e308": 1e308,
    "400 digits": 10**400,
    "way out": "../../../etc/passwd",
    "absolute": "/etc/passwd",
    "control": "a\n\x1b[2J\r\x00.png",
    "surrogate": "\ud800.png",
    "long": "x" * 100_000,
    "deep": json.loads("[" * 500 + "]" * 500),
    "null": None,
    "pipe": "pipe.png",
}
FIELDS: dict[str, tuple[tuple[Any, ...], ...]] = {
    "nerfstudio": (
        *(("frames", 1, "file_path"), ("frames", 1, "transform_matrix", 0, 3), ("frames", 1, "time"), ("frames", 1, "mask_path")),
        *(("fl_x",), ("w",), ("k1",), ("camera_model",), ("fps",), ("ply_file_path",), ("train_filenames",)),
    ),
    "dnerf": (("camera_angle_x",), ("frames", 1, "file_path"), ("frames", 1, "time")),
    "panoptic": (("w",), ("fn", 1, 0), ("cam_id", 1, 0), ("k", 1, 0, 0, 0), ("w2c", 1, 0)),
    "nerfies": (("train_ids", 1), ("val_ids",)),
    "nerfies:metadata": (("001", "warp_id"), ("001",)),
    "nerfies:scene": (("scale",), ("center", 1)),
    "record3d": (("w",), ("K", 0), ("K",), ("poses", 1, 0), ("poses", 1), ("fps",), ("frameTimestamps", 1)),
    "polycam": (("t_00",), ("t_03",), ("fx",), ("width",)),
    "nerfies:camera": (("focal_length",), ("position", 0), ("image_size",), ("orientation", 1, 1)),
}


def cases() -> Iterator[Case]:
    for kind, file in FILES.items():
        layout = kind.split(":")[0]
        label = f"{kind}: {file}" if kind == "record3d" else file
        for what, text in TEXTS.items():
            of_others = kind == "record3d" and what == "millions of lists"  # sound, but no file of Record3D
            yield Case(f"{label}: {what}", layout, replace(file, text), names=() if of_others else (file,))
        yield Case(f"{label}: a terabyte", layout, sparse(file), names=(file,))
        yield Case(f"{label}: a folder", layout, node(file, "folder"), names=(file,))
        yield Case(f"{label}: a link to itself", layout, node(file, Path(file).name), names=(file,))
        for number, field in enumerate(FIELDS[kind]):
            # every value somewhere, every field with several: all pairs would say little more
            for k, (what, value) in enumerate(VALUES.items()):
                if (k + number) % 3 == 0 or (kind == "nerfstudio" and number < 2):
                    word = next(key for key in reversed(field) if isinstance(key, str))
                    yield Case(f"{label}: {'.'.join(map(str, field))}: {what}", layout, _set(file, field, value), names=(file, word))


def _set(file: str, field: tuple[Any, ...], value: Any) -> Callable[[Path], None]:
    def damage(root: Path) -> None:
        node("pipe.png", "pipe")(root)
        data = json.loads((root / file).read_text())
        place = data
        for key in field[:-1]:
            place = place[key]
        place[field[-1]] = value
        put(root, file, data)

    return damage
