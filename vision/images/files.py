"""Opens an untrusted image file: the content decides the format, sizes are bounded, and every failure is one kind of error."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from PIL.Image import Image

# JPEG includes MPO, which phones write. Pillow would open more formats, whatever the file's suffix; for EPS it would start Ghostscript.
FORMATS = ("PNG", "JPEG", "WEBP", "BMP", "DIB", "TIFF")
MOST_PIXELS = 178_956_970  # beyond this Pillow refuses a file as a decompression bomb; 16 bits and four channels then take 1.4 GB
MOST_BYTES = 2**31


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
        with Image.open(path, formats=FORMATS) as image:
            if min(image.size) < 1:
                raise BadImageError(f"its size is {image.width}x{image.height}")
            yield image
    except BadImageError:
        raise
    except Exception as error:  # for broken files Pillow raises struct.error, KeyError, IndexError, zlib.error, ...
        raise BadImageError(str(error) or type(error).__name__) from error
