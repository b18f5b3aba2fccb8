"""Opens an untrusted image file: the content decides the format, sizes are bounded, and every failure is one kind of error."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TYPE_CHECKING

if TYPE_CHECKING:
    from PIL.Image import Image

# JPEG includes MPO, which phones write. Pillow would open more formats, whatever the file's suffix; for EPS it would start Ghostscript.
FORMATS = ("PNG", "JPEG", "WEBP", "BMP", "DIB", "TIFF")
MOST_PIXELS = 178_956_970  # beyond this Pillow refuses a file as a decompression bomb; 16 bits and four channels then take 1.4 GB
MOST_BYTES = 2**31
ORIENTATION = 0x0112  # the EXIF field; 1 is as stored, 2 to 8 ask for a turn or a mirror
LYING = (5, 6, 7, 8)  # its values that include a quarter turn
_MOST_CHUNKS = 100_000  # of a PNG; one of a gigabyte in the usual pieces has as many
CODING = "cicp"  # of an opened PNG's `info`: the data of its cICP chunk, which Pillow skips
_BACK = {6: 8, 8: 6}  # the orientation that undoes another; the others undo themselves


class BadImageError(Exception):
    """The file cannot be opened or decoded; the message says why."""


@contextmanager
def open_image(path: Path) -> Iterator[Image]:
    """The image at ``path``, in one of `FORMATS`, not decoded yet. Any failure with the file, here or in the block, raises
    BadImageError."""
    import warnings

    from PIL import Image

    warnings.filterwarnings("ignore", module=r"PIL\.")  # about large photos and odd tags; what matters is raised as an error
    try:
        if not path.is_file():  # reading a pipe would block
            raise BadImageError("it is not a file")
        if path.stat().st_size > MOST_BYTES:
            raise BadImageError(f"more than {MOST_BYTES >> 30} GiB")
        # From an open file, since by its name Pillow maps some files into memory, and then scrambles grey TIFFs that ask for a turn.
        with path.open("rb") as file, Image.open(file, formats=FORMATS) as image:
            if min(image.size) < 1:
                raise BadImageError(f"its size is {image.width}x{image.height}")
            if image.format == "PNG" and (coding := _coding(file)) is not None:
                image.info[CODING] = coding
            yield image
    except BadImageError:
        raise
    except Exception as error:  # for broken files Pillow raises struct.error, KeyError, IndexError, zlib.error, ...
        raise BadImageError(str(error).split(" <_io.")[0] or type(error).__name__) from error  # no object in place of the name


def orientation_of(image: Image) -> int:
    """EXIF orientation of an image from `open_image`, 2 to 8; 1 if it is not to be rotated or mirrored. To be asked before its pixels."""
    from PIL import Image as pillow

    # For what may stand behind the pixels of a PNG, Pillow decodes them, so its chunks are looked at first.
    early = image.format == "PNG" and not _more_behind_pixels(getattr(image, "fp", None))
    found = (pillow.Image.getexif(image) if early else image.getexif()).get(ORIENTATION, 1)
    return int(found) if found in range(2, 9) else 1


def _more_behind_pixels(file: IO[bytes] | None) -> bool:
    """Whether a PNG has EXIF data or texts, which may be such data, behind its pixels. Leaves the file where it was."""
    if file is None:  # the pixels have been read
        return True
    pixels = False
    for kind, _ in _chunks(file):
        pixels = pixels or kind == b"IDAT"
        if kind is None or (pixels and kind in (b"eXIf", b"tEXt", b"zTXt", b"iTXt")):
            return True
    return False


def _coding(file: IO[bytes]) -> bytes | None:
    """The data of the cICP chunk of a PNG, which comes before the pixels; None if it has none. Leaves the file where it was."""
    for kind, length in _chunks(file):
        if kind == b"cICP":
            return file.read(4) if length == 4 else None
        if kind in (b"IDAT", None):
            return None
    return None


def _chunks(file: IO[bytes]) -> Iterator[tuple[bytes | None, int]]:
    """(kind, bytes of data) of each chunk of a PNG up to IEND, with the file at its data; at last (None, 0) if there are too many. Leaves
    the file where it was."""
    before, at = file.tell(), 8
    try:
        for _ in range(_MOST_CHUNKS):
            file.seek(at)
            head = file.read(8)
            if len(head) < 8 or head[4:] == b"IEND":
                return
            length = int.from_bytes(head[:4], "big")
            yield head[4:], length
            at += 12 + length
        yield None, 0
    finally:
        file.seek(before)


def stored_size(image: Image) -> tuple[int, int]:
    """Width and height, px, as the file stores them. Pillow gives a TIFF the size that it has once it is turned."""
    if image.format != "TIFF":
        return image.size
    width, height = (int(image.tag_v2[tag]) for tag in (256, 257))  # type: ignore[attr-defined]
    return width, height


def pixels(image: Image, upright: bool) -> Image:
    """The decoded image from `open_image`: as stored, or upright, i.e. rotated and mirrored as its EXIF orientation asks.

    Pillow turns a TIFF while it loads it, and nothing else. Poses in files belong to the pixels as stored, so a TIFF is turned back."""
    from PIL.Image import Transpose

    tiff = image.format == "TIFF"
    turn = orientation_of(image) if tiff or upright else 1
    image.load()
    if turn == 1 or tiff == upright:
        return image
    way = {
        2: Transpose.FLIP_LEFT_RIGHT,
        3: Transpose.ROTATE_180,
        4: Transpose.FLIP_TOP_BOTTOM,
        5: Transpose.TRANSPOSE,
        6: Transpose.ROTATE_270,
        7: Transpose.TRANSVERSE,
        8: Transpose.ROTATE_90,
    }
    return image.transpose(way[turn if upright else _BACK.get(turn, turn)])
