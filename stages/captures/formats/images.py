"""A folder of images: one camera over time in the natural order of the names, or a static scene with `--static`."""

from __future__ import annotations

import os
import posixpath
import re
from pathlib import Path

from ....pipeline import CaptureError
from .. import checks
from ..brackets import middle_exposures
from ..exposure import second_of
from ..keep_masks import add_masks, turn_masks
from ..listing import copies
from ..listing.kinds import PICTURE, colour_only, kind_of
from ..listing.names import by_value, is_image
from ..listing.numbers import give_no_order, grid, places, words
from ..listing.several import apart, several, told
from ..listing.twins import without_depth
from ..listing.unread import described
from ..panorama import refuse_pictures
from ..photos.rolls import roll
from ..posed.camera_matrix import CAMERA_MATRIX, read_camera_matrix
from ..posed.camera_matrix import told as told_matrix
from ..reading import Options, Reading, Shot
from . import video

_COPY = re.compile(r"images_\d+")


def detect(root: Path) -> str | None:
    folder = _folder(root)
    if folder is None and (rolled := roll(root)) is not None:
        return f"{len(rolled.names)} images in folders of one camera"
    return None if folder is None else f"{len(_images(root / folder))} images in {folder or 'the folder'}"


def read(root: Path, options: Options) -> Reading:
    folder = _folder(root)
    if folder is None and options.format == "images" and (root / "images").is_dir() and _images(root / "images"):
        folder = "images"  # the user chose this format, so other folders next to it do not matter
    rolled = roll(root) if folder is None else None
    if folder is None and rolled is None:
        there = described(root) if root.is_dir() else ""
        raise CaptureError(f"{root}: no images here; pass the folder that holds them{there}")
    prefix = rolled.prefix if rolled else f"{folder}/" if folder else ""
    listed = rolled.names if rolled else [prefix + name for name in _images(root / (folder or ""))]
    copied = copies.named_copies(root, listed)
    edits = copies.edited([name for name in listed if name not in copied])
    found, deep, said = without_depth(root, [name for name in listed if name not in copied and name not in edits])
    found, ordered_by = ([*found], ()) if options.static else _by_date(root, found)
    found, dimmer, bracketed = middle_exposures(root, found)
    if len(found) < 2:
        if dimmer:
            raise CaptureError(f"{root}: {bracketed[0]}. One view alone has no pose and no depth; add more views of the scene")
        if found and (pictures := several(root / found[0])) is not None:
            raise CaptureError(apart(root / found[0], pictures))
        raise CaptureError(f"{root}: one image alone has no pose and no depth; add more views of the scene{described(root, 2)}")
    taken = video.choose(len(found), options, None)
    video.refuse_one(str(root), taken, len(found), options)
    paths = [found[i] for i in taken]
    sizes, alpha, upright = checks.upright_headers(root, paths)  # only this format follows EXIF: poses apply to pictures as stored
    refuse_pictures(root, paths, sizes)
    hint = read_camera_matrix(root, prefix + CAMERA_MATRIX, *sizes[0])
    if hint is not None and len(set(sizes)) > 1:
        raise CaptureError(
            f"{prefix}{CAMERA_MATRIX}: one camera matrix for images of {len(set(sizes))} sizes; remove the file, or keep to one size"
        )
    bare = [posixpath.basename(name) if rolled else name for name in found]  # folders of one roll have numbers of their own
    clock, gaps = (range(len(found)), None) if options.static else places(bare)
    shots = [
        Shot(name=path, camera=0, time=float(clock[i]), size=size, file=path) for i, path, size in zip(taken, paths, sizes, strict=True)
    ]
    if len(taken) < clock[-1] + 1:  # those that were not taken, or are missing, have had their time, too
        for i, shot in zip(taken, shots, strict=True):
            shot.step = clock[i]
    masked = add_masks(root, shots, prefix)
    if upright:
        turn_masks(root, shots)
    thinned = (f"took {len(taken)} of {len(found)} images (every {taken[1] - taken[0]})",) if len(taken) < len(found) else ()
    ordered = by_value([name.removeprefix(prefix) for name in found])
    decimals = (f"the names are decimal numbers and are sorted by value: {found[0]} to {found[-1]}",) if ordered else ()
    order = [gaps] if gaps else _rig_told(bare, options.static)
    # Frames of a video and photos of a static scene cannot be told apart by their files; only --static says that nothing moves.
    return Reading(
        why=f"{len(found)} images without poses, {'a static scene' if options.static else 'one camera over time'}",
        shots=shots,
        alpha=alpha,
        sources=(*([prefix + CAMERA_MATRIX] if hint is not None else []), *copied),
        K_hint=hint,
        upright=upright,
        notes=(
            *((rolled.note,) if rolled else ()),
            *thinned,
            *ordered_by,
            *decimals,
            *order,
            *told(root, paths),
            *copies.told(copied, "pictures"),
            *copies.told_edited(edits, "pictures"),
            *said,
            *bracketed,
            *masked,
            *told_matrix(hint, prefix + CAMERA_MATRIX, *sizes[0]),
        ),
        spoken_for=(*deep, *dimmer, *edits),
    )


def _by_date(root: Path, names: list[str]) -> tuple[list[str], tuple[str, ...]]:
    """`names` in the order of their EXIF dates, if they give no order themselves, and a line about it."""
    if not give_no_order(names):
        return names, ()
    seconds = [second_of(root / name) for name in names]
    known = [second for second in seconds if second is not None]
    if len(known) == len(names) and len(set(known)) > len(names) // 2:
        order = sorted(range(len(names)), key=lambda i: known[i])
        return [names[i] for i in order], (f"the names give no order, so the EXIF dates do: {names[order[0]]} to {names[order[-1]]}",)
    return names, (
        "the names give no order, and there are no EXIF dates: time follows the alphabet; number the pictures as they were taken, or use "
        "--static if nothing moves",
    )


def _rig_told(names: list[str], static: bool) -> list[str]:
    """A line about names with two numbers in all combinations, of which one may be the camera, or with other words for the same numbers,
    which alone matter in a static scene."""
    if not static and (counts := grid(names)) is not None:
        seen = f"two numbers in all combinations ({counts[0]} by {counts[1]}, {names[0]} to {names[-1]})"
    elif (named := words(names)) is not None:
        first = [names[named[0].index(text)] for text in sorted(set(named[0]))]
        seen = f"the same numbers with other words (first {' and '.join(first[:3])}{' and others' if len(first) > 3 else ''})"
    else:
        return []
    if static:
        return [f"the names hold {seen}; if they are versions of one picture, keep one of each"]
    return [
        f"the names hold {seen}, as those of several cameras at several times do, but they are read as ONE camera over time; if there are "
        "several, put the pictures of each into a folder camNN/ and add their poses, or encode one video of each camera and give the "
        "folder of videos; if they are versions of one picture, keep one of each"
    ]


def _images(folder: Path) -> list[str]:
    """The pictures in a folder that show colours; depth and masks of the same names are left out."""
    return colour_only([name for name in checks.list_files(folder) if is_image(name)])


def _folder(root: Path) -> str | None:
    """ "" if the images lie in `root`, "images" if that is the only folder with pictures apart from copies in another size (images_4/) and
    those whose name says that they show something else than colours (masks/, depth/), None if there are no images."""
    if not root.is_dir():
        return None
    if _images(root):
        return ""
    folders = [name for name in checks.list_folder(root) if (root / name).is_dir()]
    if "images" not in folders or not _images(root / "images"):
        return None
    others = [name for name in folders if name != "images" and not _COPY.fullmatch(name) and kind_of(f"{name}/0.png") is PICTURE]
    return None if any(_holds_pictures(root / name) for name in others) else "images"


def _holds_pictures(folder: Path) -> bool:
    """Whether a folder beside images/ has a picture directly in it, so that it could be meant as well. What macOS packs into archives and
    workspaces do not count."""
    if checks.is_foreign(folder):
        return False
    try:
        with os.scandir(folder) as entries:
            return any(e.name.lower().endswith(checks.IMAGE_SUFFIXES) and not e.name.startswith(".") and e.is_file() for e in entries)
    except OSError:  # nothing can be read from it, so it is not the one that is meant
        return False
