"""Opening an image file that nobody has vouched for: formats by their content, sizes within bounds, every failure one kind of error."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from PIL.Image import Image

# JPEG stands for MPO too, what phones write. Pillow knows more formats, whatever a file's name ends in; that of EPS starts Ghostscript.
FORMATS = ("PNG", "JPEG", "WEBP", "BMP", "DIB", "TIFF")
MOST_PIXELS = 178_956_970  # where Pillow takes a file for a bomb; a picture of 16 bits and four channels then has 1.4 GB
MOST_BYTES = 2**31


class BadImageError(Exception):
    """The file cannot be opened or decoded; the message says why."""


@contextmanager
def open_image(path: Path) -> Iterator[Image]:
    """The image at ``path``, of one of `FORMATS`, not decoded yet. Whatever fails with the file, here or in the block, raises
    BadImageError."""
    import warnings

    from PIL import Image

    warnings.filterwarnings("ignore", module=r"PIL\.")  # large photos, odd tags: an error says what matters
    try:
        if not path.is_file():  # a pipe would be waited for
            raise BadImageError("it is no file")
        if path.stat().st_size > MOST_BYTES:
            raise BadImageError(f"more than {MOST_BYTES >> 30} GiB")
        with Image.open(path, formats=FORMATS) as image:
            if min(image.size) < 1:
                raise BadImageError(f"its size is {image.width}x{image.height}")
            yield image
    except BadImageError:
        raise
    except Exception as error:  # Pillow lets struct.error, KeyError, IndexError, zlib.error, ... of broken files through
        raise BadImageError(str(error) or type(error).__name__) from error
