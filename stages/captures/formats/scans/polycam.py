"""Polycam's raw data: `keyframes/images/` and `keyframes/cameras/`, or `corrected_images/` and `corrected_cameras/`, where there is a loop.

A camera file has the name of its picture, a time stamp, and the entries `t_00` to `t_23` of the camera-to-world matrix, OpenGL axes
(ARKit's, y up), and `fx`, `fy`, `cx`, `cy`, `width`, `height`. Facts from github.com/nerfstudio-project/nerfstudio
(process_data/polycam_utils.py, which also permutes the axes of the world; here the world stays that of the files) and
github.com/PolyCam/polyform.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .....pipeline import CaptureError
from ... import checks
from ...posed.depth import told_depth
from ...posed.finding import left_out
from ...posed.sizes import scale_of
from ...posed.stated import states_layout
from ...reading import Options, Reading, Shot
from ..transforms import OPENCV_FROM_OPENGL

_BASE = "keyframes"
_PAIRS = (("corrected_images", "corrected_cameras"), ("images", "cameras"))


def detect(root: Path) -> str | None:
    base = None if states_layout(root) else _base(root)
    pictures = [] if base is None else [i for i, _ in _PAIRS if (root / base / i).is_dir()]
    return f"{base or '.'}/ of Polycam" if pictures else None


def read(root: Path, options: Options) -> Reading:
    base = _base(root)
    pair = None if base is None else next((p for p in _PAIRS if all((root / base / name).is_dir() for name in p)), None)
    if base is None or pair is None:
        raise CaptureError(
            f"{root}: Polycam's raw data without {_BASE}/cameras or {_BASE}/corrected_cameras beside the pictures; export the raw data "
            "again (with developer mode on), or give the folder of pictures itself to have poses estimated"
        )
    prefix = f"{base}/" if base else ""
    images, cameras = (prefix + name for name in pair)
    names = {n.rsplit(".", 1)[0]: f"{images}/{n}" for n in checks.list_folder(root / images) if n.lower().endswith(checks.IMAGE_SUFFIXES)}
    files = {n[:-5]: f"{cameras}/{n}" for n in checks.list_folder(root / cameras) if n.endswith(".json")}
    both = [stem for stem in files if stem in names and (root / names[stem]).is_file()]
    bare, unposed = [s for s in files if s not in both], [s for s in names if s not in files]
    if not both or 2 * len(bare) > len(files):
        raise CaptureError(
            f"{cameras}/: {len(bare)} of {len(files)} camera files have no picture of their name in {images}/; add the files"
        )
    for stem in both:
        checks.resolve_inside(root, names[stem], names[stem])
    sizes, alpha = checks.image_headers(root, [names[stem] for stem in both])
    stamps = all(stem.isascii() and stem.isdecimal() and len(stem) < 19 for stem in both)
    shots = []
    for rank, (stem, size) in enumerate(zip(both, sizes, strict=True)):
        shot = _shot(root, files[stem], names[stem], size)
        shot.time = float(int(stem) - int(both[0])) if stamps else float(rank)
        shots.append(shot)
    notes = [left_out([files[s] for s in bare], len(files), "camera files have no picture and are left out")] if bare else []
    notes += [left_out([names[s] for s in unposed], len(names), "pictures have no camera file and are left out")] if unposed else []
    unread = tuple(prefix + name for name in ("depth", "confidence") if (root / base / name).is_dir())
    others = tuple(prefix + name for other in _PAIRS if other != pair for name in other if (root / base / name).is_dir())
    notes += [f"{', '.join(f'{name}/' for name in others)} not read: {images}/ and {cameras}/ replace them"] if others else []
    return Reading(
        why=f"{images}/ and {cameras}/ of Polycam, one moving camera",
        shots=shots,
        alpha=alpha,
        sources=tuple(files[stem] for stem in both),
        notes=tuple(notes),
        depth_notes=told_depth(root, unread),
        spoken_for=(*unread, *others, *(files[s] for s in bare), *(names[s] for s in unposed)),
    )


def _base(root: Path) -> str | None:
    """The folder that holds pictures and cameras, relative to ``root``: keyframes/, or "" if that folder itself was given."""
    if (root / _BASE).is_dir():
        return _BASE
    return "" if root.name == _BASE and any(all((root / name).is_dir() for name in pair) for pair in _PAIRS) else None


def _shot(root: Path, file: str, picture: str, size: tuple[int, int]) -> Shot:
    data = checks.read_json(root, file)

    def value(key: str, low: float = -1e12, high: float = 1e12) -> float:
        if data.get(key) is None:
            what = "the pose" if key.startswith("t_") else "the lens"
            raise CaptureError(f"{file}: {key}: missing, and so is {what}; export the raw data again or remove the file")
        return checks.number(data[key], f"{file}: {key}", low, high)

    pose = np.array([[value(f"t_{row}{column}") for column in range(4)] for row in range(3)])
    K = checks.intrinsics(value("fx"), value("fy"), value("cx"), value("cy"), file)
    made_for = value("width", 1, 1e6), value("height", 1, 1e6)
    shot = Shot(name=picture, camera=0, time=0.0, size=size, file=picture)
    shot.cam_from_world = checks.inverse(checks.rigid(pose, f"{file}: t_00 to t_23") @ OPENCV_FROM_OPENGL)
    shot.K = np.diag([*scale_of(root, picture, size, made_for, f"{file}: width, height say"), 1.0]) @ K
    return shot
