"""`extract_strongest`: the strongest SIFT features of every image, by OpenCV. Runs in the worker process: imports pycolmap."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np
import pycolmap

from .....pipeline import thread_count
from ....images.files import open_image, pixels
from .database import CHUNK_OF_FEATURES, Report, register

CONTRAST = 0.02  # OpenCV divides it by the layers of an octave; COLMAP's threshold of a peak is 0.02 / 3 of such a layer
SCALE = 512.0  # of descriptors stored as bytes, as COLMAP's


def extract_strongest(
    path: Path, root: Path, names: Sequence[str], camera_ids: Sequence[int], most: int, report: Report, masks: str | None = None
) -> None:
    """Finds up to `most` features of every image, enlarged to twice its size; images that have features are skipped.

    `camera_ids[i]` is the camera of `names[i]`; masks: as for `extract`. OpenCV takes a third of the time of COLMAP's own SIFT, and keeps
    the features of highest contrast where COLMAP keeps the largest, whose positions are less exact. Keypoints are [N, 2] px, pixel centres
    at +0.5; descriptors are square roots of the L1-normalised ones [N, 128], as COLMAP's.
    """
    register(path, root, names, camera_ids)
    cv2.setNumThreads(1)  # one picture a core is faster than one after the other on all
    masked = None if masks is None else Path(masks)
    with pycolmap.Database.open(path) as database:
        images = {image.name: image.image_id for image in database.read_all_images()}
        todo = [name for name in names if not database.exists_descriptors(images[name])]
    done = len(names) - len(todo)
    report("features", done, len(names))
    for start in range(0, len(todo), CHUNK_OF_FEATURES):
        chunk = todo[start : start + CHUNK_OF_FEATURES]
        with ThreadPoolExecutor(thread_count()) as pool:
            features = list(pool.map(lambda name: _features(root / name, masked and masked / f"{name}.png", most), chunk))
        with pycolmap.Database.open(path) as database, pycolmap.DatabaseTransaction(database):
            for name, (keypoints, descriptors) in zip(chunk, features, strict=True):
                database.write_keypoints(images[name], keypoints)
                database.write_descriptors(images[name], pycolmap.FeatureDescriptors(pycolmap.FeatureExtractorType.SIFT, descriptors))
        done += len(chunk)
        report("features", done, len(names))


def _features(picture: Path, mask: Path | None, most: int) -> tuple[np.ndarray, np.ndarray]:
    """Keypoints [N, 2] float32 px and descriptors [N, 128] uint8."""
    with open_image(picture) as image:
        grey = np.asarray(pixels(image, False).convert("L"))
    keep = None
    if mask is not None and mask.is_file():
        with open_image(mask) as image:
            keep = np.asarray(pixels(image, False).convert("L"))
    sift = cv2.SIFT.create(nfeatures=most, contrastThreshold=CONTRAST, enable_precise_upscale=True)
    found, raw = sift.detectAndCompute(grey, keep)
    if raw is None or not len(found):
        return np.zeros((0, 2), np.float32), np.zeros((0, 128), np.uint8)
    places = np.array([point.pt for point in found], np.float32) + np.float32(0.5)
    roots = np.sqrt(raw / np.maximum(raw.sum(axis=1, keepdims=True), 1e-9))
    return places, np.clip(np.round(SCALE * roots), 0, 255).astype(np.uint8)
