"""What lies in a capture and is not read: one line for each known kind of file, so that nothing is ignored in silence."""

from __future__ import annotations

import posixpath
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from ....pipeline import CaptureError
from .kinds import (
    BAND,
    CALIBRATION,
    COPY,
    DYNAMIC,
    LOW,
    MODEL,
    OTHER_POSE,
    PICTURE,
    POSE,
    THUMBNAIL,
    VIDEO,
    FileKind,
    clip_of,
    kind_of,
)
from .names import is_image, natural_key
from .sidecars import posed_sidecars, posed_tables
from .tree import MOST_DEEP, MOST_FILES, tree

_MASK, _MASKS = "mask", "masks"
MASK_PLACES = "masks/ beside images/ (give the folder that holds both), masks/ in a flat folder of photos, mask_path of transforms.json"
_SCALED = re.compile(r"(.*?)_?(\d+x?)?")  # images_4 and images, or 2x and 4x in rgb/
_GROUPS = ("pose", "picture", "video", "other")  # the order of the lines
_NAMED = {  # kinds of which those that belong to a picture by name are read
    "depth map": "depth is read by the name of its picture",
    "confidence map": "confidence goes with depth, which is read by the name of its picture",
}
_POSED_PICTURES = ("dnerf", "panoptic", "nerfstudio", "nerfies", "colmap", "llff", "record3d", "polycam", "rgbd", "tum")


def unread(root: Path, layout: str, read: Iterable[str], spoken_for: Sequence[str] = (), thinned: bool = False) -> tuple[str, ...]:
    """Lines for people about files in the folder `root` on which the result does not depend.

    read: the capture's files, relative to `root`. spoken_for: files and folders that the reader's own notes name. thinned: pictures of the
    folders that are read were left out on purpose, and the notes say how many."""
    found = tree(root)
    read = set(read)
    lines = []
    if (root / _MASKS).is_dir() and not _within(_MASKS, spoken_for) and not any(_within(path, [_MASKS]) for path in read):
        lines.append(f"the folder {_MASKS}/ is ignored, because the layout is {layout}; masks are read from {MASK_PLACES}")
        spoken_for = (*spoken_for, _MASKS)
    groups, models = _groups(root, found.files, read, spoken_for, thinned)
    for kind in sorted(groups, key=lambda kind: (_GROUPS.index(kind.group), kind.many)):
        lines.append(_line(kind, groups[kind], layout, read, models if kind is POSE else []))
    if not found.whole:
        lines.append(
            f"the folder has more than {MOST_FILES} files, or folders more than {MOST_DEEP} deep: whether others are left "
            "unread was not checked"
        )
    return tuple(lines)


def _groups(
    root: Path, files: Sequence[str], read: set[str], spoken_for: Sequence[str], thinned: bool
) -> tuple[dict[FileKind, list[str]], list[str]]:
    """The files in `root` that are not read, by kind, and the folders of COLMAP models that are not read."""
    folders, beside = {posixpath.dirname(path) for path in read if is_image(path)}, {posixpath.dirname(path) for path in read}
    models, used = _models(files, read)
    told = {folder for folder in models if any(_within(f"{folder}/{part}".lstrip("/"), spoken_for) for part in _MODEL_FILES)}
    models = [folder for folder in models if folder not in told]
    groups: dict[FileKind, list[str]] = {POSE: []} if models else {}
    by_content = posed_sidecars(root, files) | posed_tables(root, files)
    for path in files:
        if path in read or _within(path, spoken_for):
            continue
        folder, name = posixpath.split(path)
        of_model = _stem(name).lower() in MODEL
        if ((folder in models or folder in told) and of_model) or (folder in used and (of_model or name.lower() == "points3d.ply")):
            continue
        kind = OTHER_POSE if path in by_content else kind_of(path)
        if kind is None or (thinned and kind.group == "picture" and kind not in (BAND, DYNAMIC) and not kind.advice and folder in beside):
            continue
        groups.setdefault(COPY if kind is PICTURE and folder not in folders and _copies(folder, folders) else kind, []).append(path)
    return groups, models


def described(root: Path, least: int = 1) -> str:
    """Sentences about what an unusable folder has, ". " before each; empty if that is nothing known. least: number of kinds that can
    be read from which on they are worth a sentence."""
    groups, models = _groups(root, tree(root).files, set(), (), False)
    kinds = sorted(groups, key=lambda kind: (_GROUPS.index(kind.group), kind.many))
    closed = [f"{_counted(kind, groups[kind])} cannot be read: {_advice(kind, groups[kind])}" for kind in kinds if _is_closed(kind)]
    named = [_model(folder) for folder in models] + _patterns(groups.get(POSE, []))
    others = named + [_counted(kind, groups[kind]) for kind in kinds if not _is_closed(kind) and kind is not POSE]
    sentences = [text[0].upper() + text[1:] for text in closed]
    if others and len(others) >= least:
        sentences.append(f"In it {'is' if len(others) == 1 and not others[0][0].isdigit() else 'are'} {'; '.join(others)}")
    return "".join(f". {sentence}" for sentence in sentences)


def only_closed(root: Path) -> bool:
    """Whether a folder has pictures or videos, and none of a kind that is read."""
    kinds = {kind for path in tree(root).files if (kind := kind_of(path)) is not None and kind.group in ("picture", "video")}
    return bool(kinds) and all(map(_is_closed, kinds))


def refuse_closed(file: Path) -> None:
    """Raises CaptureError, with the advice that its folder would get, for a video of a kind that is not read."""
    kind = kind_of(file.name)
    if kind is not None and kind.group == "video" and kind.advice:
        raise CaptureError(f"{file}: a video of a kind that cannot be read ({kind.one}): {_advice(kind, [file.name])}")


def models_in(root: Path) -> list[str]:
    """The folders with a COLMAP model, relative to `root`, in natural order."""
    return _models(tree(root).files, set())[0]


def with_pictures(root: Path) -> bool:
    """Whether a folder, or one in it, has a picture or a video, of whatever kind."""
    return any((kind := kind_of(path)) is not None and kind.group in ("picture", "video") for path in tree(root).files)


def _is_closed(kind: FileKind) -> bool:
    return kind.group in ("picture", "video") and bool(kind.advice)


def above(root: Path, layout: str, read: Iterable[str] = ()) -> tuple[str, ...]:
    """Lines about what lies beside a video file, or a folder `images/`, that was given in place of the folder that holds both. read: the
    capture's files, of a video file relative to its folder."""
    if root.is_dir() and root.name.lower() != "images":
        return ()
    try:
        names = sorted(entry.name for entry in root.parent.iterdir())
    except OSError:
        return ()
    lines = _beside_video(root, names, set(read)) if root.is_file() else []
    if root.is_dir():
        tables = posed_tables(root.parent, names)
        poses = [name for name in names if kind_of(name) is POSE and name not in tables and (root.parent / name).is_file()]
        poses += [f"{name}/" for name in ("sparse", "colmap") if name in names]
        others = [name for name in names if (kind_of(name) is OTHER_POSE or name in tables) and (root.parent / name).is_file()]
        if others:
            lines.append(f"beside the folder {root.name}/ {_line(OTHER_POSE, others, layout, set(), ())}")
        if poses:
            verb = "is" if len(poses) == 1 else "are"
            lines.append(f"{_joined(poses)} beside the folder {root.name}/ {verb} not read; give the folder that holds both")
    if _MASKS in names and (root.parent / _MASKS).is_dir() and not (root / _MASKS).is_dir():
        lines.append(f"the folder {_MASKS}/ is ignored, because the layout is {layout}; masks are read from {MASK_PLACES}")
    return tuple(lines)


def _beside_video(file: Path, names: Sequence[str], read: set[str]) -> list[str]:
    """A line about poses and calibrations in the folder of a video that was given alone."""
    found = [name for name in names if (file.parent / name).is_file() and name not in read and not name.startswith(".")]
    tables = posed_tables(file.parent, found)
    kinds = {name: kind_of(name) for name in found}
    told = [name for name, kind in kinds.items() if name in tables or (kind and (kind.group == "pose" or kind.one == CALIBRATION))]
    told += [f"{name}/" for name in ("sparse", "colmap") if name in names and (file.parent / name).is_dir()]
    if not told:
        return []
    few = told if len(told) <= 4 else [*told[:3], f"{len(told) - 3} more"]
    return [
        f"{_joined(few)} beside the video {file.name} {'is' if len(told) == 1 else 'are'} not read: beside a video K.txt alone is read, if "
        "its folder has no other video and no photos; poses are read beside pictures"
    ]


def _line(kind: FileKind, paths: list[str], layout: str, read: set[str], models: Sequence[str]) -> str:
    if kind is POSE:
        named = [_model(folder) for folder in models] + _patterns(paths)
        many = len(named) > 1 or named[0][0].isdigit()
        return f"{_joined(named)} {'are' if many else 'is'} not read, because the layout is {layout}"
    text = f"{_counted(kind, paths)} {'is' if len(paths) == 1 else 'are'} not read"
    if kind.group == "picture" and kind.advice:
        twins = {posixpath.splitext(path)[0].lower() for path in read if is_image(path)}
        if all(posixpath.splitext(path)[0].lower() in twins for path in paths):
            return f"{text}; each has the name of a picture that is read"
    if kind is THUMBNAIL:
        return text
    if kind is BAND:
        return f"{text}, because colours are learned from the colour pictures of the same views"
    if kind is DYNAMIC:
        return (
            f"{text}, because white in them marks what is ignored, as black does here; to use them, invert them and name each like its "
            f"picture. Masks are read from {MASK_PLACES}"
        )
    if kind.one == _MASK:
        return f"{text}, because the layout is {layout}; masks are read from {MASK_PLACES}"
    if kind is LOW and {clip_of(path) for path in paths} <= {clip_of(path) for path in read if kind_of(path) is VIDEO}:
        return f"{text}; {'the video itself is' if len(paths) == 1 else 'the videos themselves are'}"
    if kind.advice and not (kind is OTHER_POSE and layout in (*_POSED_PICTURES, "n3v")):  # which have poses already
        return f"{text}; {_advice(kind, paths)}"
    if kind is COPY:
        return f"{text}, because those of another folder are"
    if kind is PICTURE and layout in _POSED_PICTURES:
        return f"{text}, because no camera of the layout {layout} uses {'it' if len(paths) == 1 else 'them'}"
    pictures = [path for path in read if kind_of(path) is PICTURE]
    if pictures and kind.one in _NAMED:
        return f"{text}, because {_NAMED[kind.one]}: that of {_example(pictures)}"
    return f"{text}, because the layout is {layout}"


def _example(pictures: Sequence[str]) -> str:
    """The first picture, and where its depth map would lie."""
    first = min(pictures, key=natural_key)
    folder, name = posixpath.split(first)
    return f"{first} would be {posixpath.join('depth', folder.partition('/')[2], _stem(name))}.png"


def _advice(kind: FileKind, paths: Sequence[str]) -> str:
    return kind.advice if len(paths) > 1 else re.sub(r"\bthem\b", "it", kind.advice)


def _counted(kind: FileKind, paths: list[str]) -> str:
    first = min(paths, key=natural_key)
    return f"the {kind.one} {first}" if len(paths) == 1 else f"{len(paths)} {kind.many} (first {first})"


def _patterns(paths: list[str]) -> list[str]:
    """Files by name, and those whose names differ in numbers alone together."""
    alike: dict[str, list[str]] = {}
    for path in sorted(paths, key=natural_key):
        alike.setdefault(re.sub(r"\d+", "0", path), []).append(path)
    result = [group[0] if len(group) == 1 else f"{len(group)} {POSE.many} (first {group[0]})" for group in alike.values()]
    return result if len(result) <= 4 else [*result[:3], f"{len(result) - 3} more {POSE.many}"]


def _models(files: Iterable[str], read: set[str]) -> tuple[list[str], set[str]]:
    """Folders with a COLMAP model: those of which nothing is read, and those of which something is."""
    members: dict[str, set[str]] = {}
    for path in files:
        folder, name = posixpath.split(path)
        if name.lower() in ("cameras.bin", "cameras.txt", "images.bin", "images.txt"):
            members.setdefault(folder, set()).add(_stem(name).lower())
    whole = [folder for folder, stems in members.items() if len(stems) == 2]
    used = {folder for folder in whole if any(f"{folder}/{part}".lstrip("/") in read for part in _MODEL_FILES)}
    return sorted((folder for folder in whole if folder not in used), key=natural_key), used


_MODEL_FILES = tuple(f"{part}{suffix}" for part in ("cameras", "images") for suffix in (".bin", ".txt"))


def _model(folder: str) -> str:
    return f"the COLMAP model in {folder}" if folder else "the COLMAP model beside the pictures"


def _copies(folder: str, folders: set[str]) -> bool:
    """Whether a folder is named like one that is read, apart from a factor: images_4 for images, rgb/4x for rgb/2x."""

    def base(path: str) -> str:
        match = _SCALED.fullmatch(posixpath.basename(path))
        return f"{posixpath.dirname(path)}/{match[1] if match else ''}"

    scaled = re.search(r"(_\d+|^\d+x)$", posixpath.basename(folder)) is not None
    return scaled and any(base(folder) == base(other) for other in folders)


def _within(path: str, places: Iterable[str]) -> bool:
    return any(path == place.rstrip("/") or path.startswith(place.rstrip("/") + "/") for place in places)


def _stem(name: str) -> str:
    return posixpath.splitext(name)[0]


def _joined(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
