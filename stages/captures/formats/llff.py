"""LLFF: `images/` (and smaller copies in `images_4/`, ...) and `poses_bounds.npy`: posed photos in the plain order of their names.

The format is documented in the README of github.com/Fyusion/LLFF ("Using your own poses without running COLMAP"), see `posed/llff_rows.py`.
"""

from __future__ import annotations

import re
from pathlib import Path

from ....pipeline import CaptureError
from .. import checks
from ..posed.llff_rows import camera_of, rows_of, told_order
from ..posed.stated import states_layout
from ..reading import Options, Reading, Shot
from . import colmap, n3v

_POSES = "poses_bounds.npy"


def detect(root: Path) -> str | None:
    if not (root / _POSES).is_file() or states_layout(root) or n3v.detect(root) is not None or colmap.detect(root) is not None:
        return None
    folders = _folders(root)
    return f"{_POSES} and {folders[0] or 'the pictures beside it'}" if folders else None


def read(root: Path, options: Options) -> Reading:
    if not (root / _POSES).is_file():
        raise CaptureError(f"{_POSES}: missing in {root}; the LLFF layout needs it beside images/")
    folders = _folders(root)
    if not folders:
        raise CaptureError(f"{root}: no pictures in images/ beside {_POSES}; add them or give another --format")
    folder = _chosen(root, folders, options.size_limit)
    names = _pictures(root, folder)
    table = rows_of(root, _POSES, names, "pictures")
    prefix = f"{folder}/" if folder else ""
    files = [prefix + name for name in names]
    for file in files:
        checks.resolve_inside(root, file, file)
    sizes, alpha = checks.image_headers(root, files)
    # Every eighth picture in plain order is the test, as in LLFF's own loaders; time runs along the numbers in the names.
    rank = {name: float(i) for i, name in enumerate(sorted(names, key=checks.natural_key))}
    shots = []
    for i, (name, file, size) in enumerate(zip(names, files, sizes, strict=True)):
        shot = Shot(name=file, camera=0, time=rank[name], size=size, file=file)
        shot.K, shot.cam_from_world = camera_of(table[i], f"{_POSES}: row {i} ({name})", root, file, size)
        shots.append(shot)
    others = tuple(other for other in folders if other != folder)
    told = (f"{', '.join(others)}: the pictures of {folder or 'the folder'} in another size, not read",) if others else ()
    return Reading(
        why=f"{_POSES} and {len(files)} images, {'a static scene' if options.static else 'one camera over time'}",
        shots=shots,
        alpha=alpha,
        untimed=True,
        sources=(_POSES,),
        notes=(*told_order(_POSES, names), *told),
        spoken_for=others,
    )


def _folders(root: Path) -> list[str]:
    """Folders with the pictures, the largest first: images/, then copies by their factor; "" if they lie beside the poses."""
    if not root.is_dir():
        return []
    copies = [name for name in checks.list_folder(root) if re.fullmatch(r"images_[1-9]\d{0,3}", name) and (root / name).is_dir()]
    found = [name for name in ("images", *copies) if (root / name).is_dir() and _pictures(root, name)]
    return found or ([""] if _pictures(root, "") else [])


def _chosen(root: Path, folders: list[str], max_size: int | None) -> str:
    """The largest pictures; with ``max_size``, the smallest that are not smaller than that."""
    chosen = folders[0]
    for folder in folders[1:] if max_size else []:
        name = _pictures(root, folder)[0]
        if max(checks.image_header(root, f"{folder}/{name}")[:2]) >= (max_size or 0):
            chosen = folder
    return chosen


def _pictures(root: Path, folder: str) -> list[str]:
    """In plain order."""
    names = checks.list_folder(root / folder)
    return sorted(name for name in names if name.lower().endswith(checks.IMAGE_SUFFIXES) and (root / folder / name).is_file())
