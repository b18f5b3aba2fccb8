"""Files of poses beside those that were read: each gets one line."""

from __future__ import annotations

import re
from pathlib import Path

from .. import checks
from ..formats.colmap_model import model_places
from ..reading import Reading

# Files with poses or calibrations that some layout, or no layout, reads; with what they are for.
_KNOWN = {
    "transforms.json": "nerfstudio",
    "transforms_train.json": "D-NeRF",
    "train_meta.json": "Panoptic",
    "poses_bounds.npy": "LLFF and Plenoptic Video",
    "poses_bounds_multipleview.npy": "4DGaussians",
    "models.json": "immersive light fields",
    "cameras.json": "3D Gaussian splatting",
    "cameras.xml": "Metashape",
    "calibration.json": "camera rigs",
    "groundtruth.txt": "TUM RGB-D",
    "cameras.sfm": "Meshroom",
    "sfm.json": "Meshroom",
}
_TRANSFORMS = re.compile(r"transforms.*\.json|.*_transforms\.json")


def other_poses(root: Path, kind: str, reading: Reading) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Notes about files of poses in the capture's folder that ``reading`` does not use, and these files."""
    if not root.is_dir() or kind == "video":
        return (), ()
    used = {*reading.sources, *reading.spoken_for}
    posed = any(shot.cam_from_world is not None for shot in reading.shots)
    why = f"the poses come from {reading.sources[0]}" if posed and reading.sources else f"the layout is {kind}"
    names = [n for n in checks.list_folder(root) if (n in _KNOWN or _TRANSFORMS.fullmatch(n)) and n not in used and (root / n).is_file()]
    notes = [f"{name} ({_KNOWN.get(name, 'nerfstudio')}) is not read, because {why}" for name in names]
    models = [] if kind == "colmap" else [p for p in model_places(root) if p.file("images") not in used]
    for place in models:
        notes.append(f"the COLMAP model in {place.folder or 'the folder'} is not read, because {why}")
    files = (place.file(part) for place in models for part in ("cameras", "images", "points3D"))
    return tuple(notes), (*names, *files)
