"""Where models lie in a capture, which pictures are theirs, and which of several is read."""

from __future__ import annotations

import posixpath
import struct
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from .....pipeline import CaptureError
from ... import checks
from . import binary, text
from .code_pages import in_code_page
from .records import CameraRecord, FrameRecord, ImageRecord

_FIRST = ("sparse", "sparse_", "colmap", "colmap_sparse", "dense", "undistorted", "distorted")  # folders of models, in this order
_DEPTH = 4
_NO_PICTURES = ("masks", "mask", "depth", "depths", "normals", "seg")
_MOST_FOLDERS = 30  # folders of other names that may hold a model's pictures
_SAMPLE = 20  # pictures whose sizes are compared with those of a model's cameras


@dataclass(frozen=True)
class Place:
    """A folder with a model, relative to the capture ("" is the capture itself), and the suffix of its files."""

    root: Path
    folder: str
    suffix: str

    def file(self, part: str) -> str:
        return self.named(f"{part}{self.suffix}")

    def named(self, name: str) -> str:
        return f"{self.folder}/{name}" if self.folder else name

    def path(self, file: str) -> Path:
        checks.resolve_inside(self.root, file, file)
        return self.root / file

    def pictures(self) -> list[str]:
        """Folders whose pictures the model may be of, the likeliest first, each with "/" at its end; "" for the capture itself."""
        above: list[str] = []
        parts = self.folder.split("/") if self.folder else []
        for length in range(len(parts), -1, -1):  # the pictures of dense/sparse are those in dense/images, else those in images
            base = "/".join(parts[:length])
            names = ("images", "input") if "distorted" not in parts else ("input", "images")
            above += [posixpath.join(base, name) + "/" for name in names if (self.root / base / name).is_dir()]
        others = [name for name in checks.list_folder(self.root) if f"{name}/" not in above and (self.root / name).is_dir()]
        return [*above, "", *(f"{name}/" for name in others[:_MOST_FOLDERS] if name not in (*_FIRST, *_NO_PICTURES))]


def model_places(root: Path) -> list[Place]:
    """All models of a capture, those in sparse/ first and numbered ones in order."""
    found: list[Place] = []

    def look(folder: str, depth: int) -> None:
        inside = depth < _DEPTH and (root / folder).is_dir()
        numbers = [n for n in _names(root / folder) if n.isdecimal() and (root / folder / n).is_dir()] if inside and depth else []
        for name in numbers:
            look(posixpath.join(folder, name), depth + 1)
        for suffix in (".bin", ".txt"):  # binary before text, as COLMAP
            place = Place(root, folder, suffix)
            if all((root / place.file(part)).is_file() for part in ("cameras", "images")):
                found.append(place)
                break
        for name in [name for name in _FIRST if inside and (root / folder / name).is_dir()]:
            look(posixpath.join(folder, name), depth + 1)

    if root.is_dir():
        look("", 0)
    # A model in the capture's own folder comes last: it is what remains when files were moved.
    return sorted(found, key=lambda place: place.folder == "")


def _names(folder: Path) -> list[str]:
    try:
        return checks.list_folder(folder)
    except CaptureError:  # what nobody may list holds no model that could be read
        return []


@dataclass
class Model:
    """A model whose files are read when they are asked for. All errors are CaptureErrors that name the file."""

    place: Place
    note: str | None = None

    @cached_property
    def cameras(self) -> dict[int, CameraRecord]:
        file = self.place.file("cameras")
        with about(file):
            return dict(self._parser.cameras(self.place.path(file)))

    @cached_property
    def images(self) -> list[ImageRecord]:
        """In the natural order of their names."""
        file = self.place.file("images")
        with about(file):
            try:
                found = list(self._parser.images(self.place.path(file)))
            except text.NotKeypoints as error:
                found = self._bare(self.place.path(file), error)
                self._say(
                    f"{file} has no lines of keypoints below its images (one for each image, which may be empty): each of its "
                    f"{len(found)} lines is read as an image"
                )
            found = self._decoded(found)
        return sorted(found, key=lambda image: checks.natural_key(image.name))

    @cached_property
    def frames(self) -> list[FrameRecord]:
        """In the order of their numbers; none in a model of COLMAP before 3.12."""
        file = self.place.file("frames")
        if not (self.place.root / file).is_file():
            return []
        with about(file):
            return sorted(self._parser.frames(self.place.path(file)), key=lambda frame: frame.number)

    @cached_property
    def pictures(self) -> str:
        """The folder of the pictures, with "/" at its end or "": the first that has at least half of the images, before others one in
        which their sizes are those of the cameras."""
        return max(self.place.pictures(), key=lambda folder: (2 * self._present(folder) >= len(self.images), self._fits(folder)))

    def has_pictures(self) -> bool:
        """Whether at least half of its images are in the folder that is taken for theirs."""
        return bool(self.images) and 2 * self._present(self.pictures) >= len(self.images)

    @property
    def rank(self) -> tuple[bool, int]:
        """Whether the sizes of its pictures are those of its cameras, and how many of its images have a picture."""
        present = self._present(self.pictures)
        return present > 0 and self._fits(self.pictures), present

    def _present(self, folder: str, images: Sequence[ImageRecord] | None = None) -> int:
        return sum(self._is_there(folder, image) for image in (self.images if images is None else images))

    def _is_there(self, folder: str, image: ImageRecord) -> bool:
        try:
            return (self.place.root / folder / image.name.replace("\\", "/")).is_file()
        except (OSError, ValueError):  # too long a name, or one with a zero byte
            return False

    def _fits(self, folder: str) -> bool:
        step = max(1, len(self.images) // _SAMPLE)
        for image in self.images[::step]:
            if image.camera not in self.cameras or not self._is_there(folder, image):
                continue
            try:
                size = checks.image_header(self.place.root, folder + image.name.replace("\\", "/"))[:2]
            except CaptureError:
                continue
            if size != self.cameras[image.camera][1:3]:
                return False
        return True

    def _bare(self, path: Path, error: text.NotKeypoints) -> list[ImageRecord]:
        """The images of a file without keypoints, if each of them has a picture; else it is an error."""
        found = self._decoded(text.bare_images(path) or [])
        for folder in self.place.pictures() if found else ():
            if all(self._is_there(folder, image) for image in found):
                return found
        raise CaptureError(f"{error}; add an empty line below each image, or export the model again") from error

    def _decoded(self, found: list[ImageRecord]) -> list[ImageRecord]:
        folders = self.place.pictures()
        found, page = in_code_page(found, lambda some: max(self._present(folder, some) for folder in folders))
        if page is not None:
            self._say(
                f"{self.place.file('images')} has names that are not UTF-8: they are read in code page {page}, as the pictures have them"
            )
        return found

    def _say(self, line: str) -> None:
        self.note = line if self.note is None else f"{self.note}; {line}"

    @property
    def _parser(self):  # type: ignore[no-untyped-def]
        return binary if self.place.suffix == ".bin" else text


def choose(root: Path) -> tuple[Model | None, tuple[str, ...], tuple[str, ...]]:
    """The model of a capture with most images; the first of equal ones; those whose cameras have the sizes of the pictures before others
    (the distorted model of undistorted pictures is none). Also notes about the others, and their files, from which this follows."""
    models = [Model(place) for place in model_places(root)]
    if len(models) < 2:
        return (models[0] if models else None), (), ()
    ranks: dict[int, tuple[bool, int]] = {}
    broken: dict[int, CaptureError] = {}
    for i, model in enumerate(models):
        try:
            ranks[i] = model.rank
        except CaptureError as error:
            broken[i] = error
    if not ranks:
        raise next(iter(broken.values()))
    best = max(ranks, key=lambda i: (ranks[i], -i))
    told = [f"{models[i].place.folder or '.'} has {len(models[i].images)}" for i in ranks if i != best]
    notes = []
    if told:
        chosen = models[best]
        notes.append(
            f"{chosen.place.folder or '.'} with {len(chosen.images)} images is read, and no other model ({', '.join(told)}): each "
            "model has a world of its own; to read another one, put it and its pictures into a folder of their own"
        )
    notes += [f"the model in {models[i].place.folder} is not read, since it is damaged: {error}" for i, error in broken.items()]
    others = [models[i].place.file(part) for i in range(len(models)) if i != best for part in ("cameras", "images")]
    return models[best], tuple(notes), tuple(others)


@contextmanager
def about(file: str) -> Iterator[None]:
    """Turns any error inside the block into a CaptureError that names `file`."""
    try:
        yield
    except CaptureError as error:
        raise CaptureError(f"{file}: {error}") from error
    except (OSError, ValueError, IndexError, struct.error, OverflowError) as error:
        raise CaptureError(f"{file}: the COLMAP model cannot be read, perhaps cut short ({error}); export it again") from error
