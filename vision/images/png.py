"""A picture as the bytes of a PNG file."""

from __future__ import annotations

import numpy as np


def encode_png(picture: np.ndarray) -> bytes:
    """Encodes ``picture``, uint8 [H, W, 3] RGB, as PNG; equal pictures give equal bytes."""
    import cv2

    ok, data = cv2.imencode(".png", np.ascontiguousarray(picture[..., ::-1]), [cv2.IMWRITE_PNG_COMPRESSION, 6])
    assert ok
    return data.tobytes()
