"""A COLMAP model (`sparse/0` and other places, text or binary) and its pictures: poses, points, and one camera over time or a rig in
sub-folders.

Pixel centres lie at +0.5 in COLMAP's intrinsics, as in ours. Poses are `cam_from_world` in OpenCV axes: a quaternion w x y z and a
translation.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from ....pipeline import CaptureError
from .. import checks
from ..keep_masks import add_masks
from ..listing.kinds import colour_only
from ..listing.names import is_image
from ..posed.finding import find_pictures
from ..posed.stated import states_layout
from ..reading import Options, Reading, Shot
from ..rigs import all_fixed, folders_of, place_untimed
from . import n3v
from .colmap_model import (
    ImageRecord,
    Model,
    Place,
    choose,
    extend_standing,
    lens_of,
    model_places,
    place_frames,
    read_cloud,
    told_twice,
)

_OWN = ("sparse/0", "sparse")  # a model here makes a capture COLMAP's, whatever lies beside it
_SMALLER = re.compile(r"images_\d+")  # copies of the pictures, as Mip-NeRF 360 and LLFF have them


def detect(root: Path) -> str | None:
    found = model_places(root)
    if not found or (found[0].folder not in _OWN and states_layout(root)):
        return None
    if n3v.detect(root) is not None:
        return None
    where = f"a COLMAP model in {found[0].folder or 'the folder'}"
    if any(folder in place.pictures() for place in found for folder in ("images/", "input/", f"{place.folder.split('/')[0]}/images/")):
        return where
    return f"{where} and its pictures" if any(_has_pictures(place) for place in found) else None


def read(root: Path, options: Options) -> Reading:
    model, notes, others = choose(root)
    if model is None:
        raise CaptureError(f"{root}: no sparse/0 with cameras and images beside images/, which a COLMAP capture needs; pass its folder")
    where = model.place.folder or "the folder"
    files = {part: model.place.file(part) for part in ("cameras", "images", "frames")}
    cameras, images, cloud = model.cameras, model.images, read_cloud(model.place)
    if not images:
        raise CaptureError(f"{files['images']}: no registered image; run structure from motion again")
    names = {i: (image.name, f"{files['images']}: image {image.name!r}: name") for i, image in enumerate(images)}
    found = find_pictures(root, names, files["images"], "images", model.pictures)
    posed, standing = extend_standing(root, found.paths, options.static)
    paths = [path for _, path in posed]
    deleted = [model.pictures + images[i].name.replace("\\", "/") for i in found.gone]
    sizes, alpha = checks.image_headers(root, paths)
    found_at = zip(posed, sizes, strict=True)
    shots = [_shot(root, images[i], path, size, cameras, files) for (i, path), size in found_at]
    registered = [images[i] for i, _ in posed]
    placed, unfollowed = place_frames(model, registered, shots) if standing is None else (None, None)
    if placed is None:
        placed = place_untimed(root, shots, options.static, deleted)
    masked = add_masks(root, shots, model.pictures)
    copies = _copies(root, model.pictures)
    notes = (
        *notes,
        *([model.note] if model.note else []),
        *told_twice(model),
        *cloud.notes,
        *found.notes,
        *([standing] if standing else []),
        *placed.notes,
        *([unfollowed] if unfollowed else []),
        *masked,
        *copies[0],
        *_told(root, model, paths, where),
    )
    cameras_told = f"{len({shot.camera for shot in shots})} cameras" if placed.several else "one camera over time"
    there = [file for part, file in files.items() if part in ("cameras", "images") or (root / file).is_file()]
    return Reading(
        why=f"a COLMAP model in {where}, {'a static scene' if options.static else cameras_told}",
        shots=shots,
        alpha=alpha,
        sources=(*there, *cloud.files, *others, *placed.others),
        points=cloud.points if len(cloud.points) else None,
        point_colors=cloud.colors if len(cloud.points) else None,
        fixed_cameras=all_fixed(shots),
        untimed=not placed.several,
        notes=notes,
        spoken_for=(*copies[1], *(file for file in others)),
    )


def _shot(root: Path, image: ImageRecord, path: str, size: tuple[int, int], cameras: dict, files: dict[str, str]) -> Shot:
    where = f"{files['images']}: image {image.name!r}"
    if image.camera not in cameras:
        raise CaptureError(f"{where}: camera {image.camera} is not in {files['cameras']}; export again")
    lens = lens_of(cameras[image.camera], f"{files['cameras']}: camera {image.camera}", root, path, size)
    shot = Shot(name=path, camera=0, time=0.0, size=size, file=path, cam_from_world=image.cam_from_world(f"{where}: pose"))
    shot.K, shot.distortion, shot.fisheye = lens
    return shot


def _told(root: Path, model: Model, paths: Sequence[str], where: str) -> tuple[str, ...]:
    """A note on pictures that the model has no pose for."""
    base = model.pictures.rstrip("/")
    listed = set[str]()
    for place in {base, *folders_of(paths)}:  # masks and depth beside their pictures are named elsewhere
        listed |= {f"{place}/{name}".lstrip("/") for name in colour_only(list(filter(is_image, checks.list_folder(root / place))))}
    unposed = listed - set(paths)
    return (f"{len(unposed)} images without a pose in {where} are left out",) if unposed else ()


def _copies(root: Path, pictures: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """A note about folders of smaller copies of the pictures, and these folders."""
    names = [
        name for name in checks.list_folder(root) if _SMALLER.fullmatch(name) and (root / name).is_dir() and name != pictures.rstrip("/")
    ]
    if not names:
        return (), ()
    verbs = ("holds", "is") if len(names) == 1 else ("hold", "are")
    text = f"{verbs[0]} the pictures of {pictures or 'the folder'} in another size and {verbs[1]} not read"
    return (f"{', '.join(names)} {text}",), tuple(names)


def _has_pictures(place: Place) -> bool:
    try:
        return Model(place).has_pictures()
    except CaptureError:
        return False
