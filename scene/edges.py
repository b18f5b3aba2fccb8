"""Edges of an image: a soft weight for losses and seeds, and a hard mask for metrics. Both use Canny's detector."""

from __future__ import annotations

import cv2
import numpy as np

# (low, high, strength): hysteresis thresholds on the gradient of 8-bit grey, strongest first. Sobel 3x3 gives a step of height h the
# gradient 4h before smoothing. Three levels let the weight follow the contrast of an edge without thinning its contour.
LEVELS: tuple[tuple[float, float, float], ...] = ((100.0, 200.0, 1.0), (50.0, 100.0, 0.66), (25.0, 50.0, 0.33))
FALLOFF = 1.0  # px, standard deviation of the weight across an edge
BLUR = 1.0  # px, smoothing before the gradient; noise of 2 grey levels stays below the weakest level


def _smooth_grey(image: np.ndarray) -> np.ndarray:
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8 or image.size == 0:
        raise ValueError(f"image: expected uint8 [H, W, 3] with H, W > 0, got {image.dtype} {list(image.shape)}")
    grey = cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2GRAY)
    return cv2.GaussianBlur(grey, (0, 0), BLUR, borderType=cv2.BORDER_REPLICATE)


def edge_weights(image: np.ndarray) -> np.ndarray:
    """Soft edge weight of each pixel of ``image`` (uint8 [H, W, 3], RGB): uint8 [H, W], 255 on a strong edge, 0 far from any.

    The weight is the maximum over three Canny levels of strength * exp(-d^2 / (2 FALLOFF^2)), where d is the distance in px to that level's
    edges. This way neither a threshold nor a one-pixel contour makes the loss jump. Raises ValueError for another shape or dtype.
    """
    grey = _smooth_grey(image)
    weight = np.zeros(grey.shape, np.float32)
    for low, high, strength in LEVELS:
        edges = cv2.Canny(grey, low, high, L2gradient=True)
        if not edges.any():
            continue  # without edges the distance is undefined
        distance = cv2.distanceTransform(255 - edges, cv2.DIST_L2, cv2.DIST_MASK_5)  # 2 % off, three times quicker than exact
        np.maximum(weight, strength * np.exp(distance * distance * (-0.5 / FALLOFF**2)), out=weight)
    return np.rint(255.0 * weight).astype(np.uint8)


def edge_mask_canny(image: np.ndarray) -> np.ndarray:
    """Canny edges of ``image`` (uint8 [H, W, 3], RGB): bool [H, W], contours one pixel wide.

    Grey, Gaussian of 1 px, Sobel 3x3, thresholds 50 and 100 on the L2 gradient. This is the mask of `edge_psnr`, so its thresholds are
    part of the reported protocol. Raises ValueError for another shape or dtype.
    """
    low, high, _ = LEVELS[1]
    return cv2.Canny(_smooth_grey(image), low, high, L2gradient=True) > 0


def near_edges(mask: np.ndarray, pixels: float) -> np.ndarray:
    """Pixels at most ``pixels`` away (Euclidean, centre to centre) from a True pixel of ``mask`` [H, W]: bool [H, W]."""
    if not mask.any():
        return np.zeros(mask.shape, bool)
    distance = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return distance <= pixels + 1e-3
