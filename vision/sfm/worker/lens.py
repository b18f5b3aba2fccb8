"""`lens_trouble`: whether a fitted lens can be real."""

from __future__ import annotations

import numpy as np

SHORTEST, LONGEST = 0.3, 5.0  # focal lengths, of the picture's longer side: fields of view of 118 and 11 degrees
STRONGEST = 1.0  # largest absolute value of any distortion term
STEPS = 64  # radii from the centre to the corner at which the lens is checked


def lens_trouble(K: np.ndarray, distortion: np.ndarray, width: float, height: float, hinted: bool = False) -> str | None:
    """What is absurd about a lens, in words; None for a plausible one.

    K [3, 3] px, distortion (k1, k2, p1, p2) of a picture of width x height px. `hinted`: the focal length came with the capture and is
    not judged. A lens whose radial distortion folds the picture over before its corners would show two directions in one pixel.
    """
    if not (np.isfinite(K).all() and np.isfinite(distortion).all()):
        return "a lens that is not a number"
    focal = float(np.sqrt(abs(K[0, 0] * K[1, 1])))
    ratio = focal / max(width, height)
    if not hinted and not SHORTEST <= ratio <= LONGEST:
        return f"a focal length of {ratio:.3g} times the longer side ({SHORTEST:g} to {LONGEST:g} are usual)"
    if np.abs(distortion).max() > STRONGEST:
        return f"a distortion of {np.abs(distortion).max():.3g} (at most {STRONGEST:g} is usual)"
    x, y = max(K[0, 2], width - K[0, 2]) / K[0, 0], max(K[1, 2], height - K[1, 2]) / K[1, 1]
    k1, k2 = float(distortion[0]), float(distortion[1])
    # The corner is at a distorted radius, so the rising branch of the distortion must reach that far.
    corner = float(np.hypot(x, y))
    radius = np.linspace(0.0, 2.0 * corner, 2 * STEPS + 1)
    rising = 1 + 3 * k1 * radius**2 + 5 * k2 * radius**4 > 0
    end = len(radius) if rising.all() else int(np.argmin(rising))
    reached = (radius * (1 + k1 * radius**2 + k2 * radius**4))[:end].max()
    if end < len(radius) and reached < corner:
        return f"a distortion (k1 {k1:.3g}, k2 {k2:.3g}) that folds the picture over before its corners"
    return None
