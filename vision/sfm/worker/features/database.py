"""The COLMAP database of one run: cameras, features and matches, filled so that a killed run resumes where it stopped.

Only the worker process imports this module, since it imports pycolmap.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pycolmap

from .....pipeline import thread_count
from ...pairs import enlarged

Report = Callable[[str, int, int], None]  # phase, done, total

CHUNK_OF_FEATURES = 8  # images per call; a killed run loses at most this many
MATCH_CHUNK = 64  # pairs per call; a killed run loses at most this many in each process
ENLARGED, AS_IT_IS = -1, 0  # SIFT's first octave: pictures at twice their size, or as they are
LOOKED = 3  # images whose features are counted to decide between the two
FEW = 2000  # features; images with fewer are enlarged whatever their size


def write_cameras(path: Path, cameras: Sequence[pycolmap.Camera]) -> list[int]:
    """Writes cameras and returns their ids in the given order. Since ids are 1, 2, ..., a resumed run finds its cameras again."""
    with pycolmap.Database.open(path) as database:
        for index in range(database.num_cameras(), len(cameras)):
            database.write_camera(cameras[index])
    return list(range(1, len(cameras) + 1))


def extract(
    path: Path,
    root: Path,
    names: Sequence[str],
    camera_ids: Sequence[int],
    max_features: int,
    report: Report,
    masks: str | None = None,
    first_octave: int = ENLARGED,
) -> None:
    """Extracts SIFT features of every image; `camera_ids[i]` is the camera of `names[i]`. Images that have features are skipped. masks: a
    folder; if it has NAME.png, the image NAME gets no features where that is black. first_octave: `ENLARGED` or `AS_IT_IS`."""
    register(path, root, names, camera_ids)
    with pycolmap.Database.open(path) as database:
        have = {image.name for image in database.read_all_images() if database.exists_descriptors(image.image_id)}
    options = pycolmap.FeatureExtractionOptions()
    options.sift.max_num_features, options.sift.first_octave, options.num_threads = max_features, first_octave, thread_count()
    done = len(have)
    report("features", done, len(names))
    for camera in sorted(set(camera_ids)):
        reader = pycolmap.ImageReaderOptions()
        reader.existing_camera_id = camera
        if masks is not None:
            reader.mask_path = masks
        todo = [name for name, c in zip(names, camera_ids, strict=True) if c == camera and name not in have]
        for start in range(0, len(todo), CHUNK_OF_FEATURES):
            chunk = todo[start : start + CHUNK_OF_FEATURES]
            pycolmap.extract_features(path, root, chunk, pycolmap.CameraMode.SINGLE, reader, options)
            done += len(chunk)
            report("features", done, len(names))


def first_octave(root: Path, names: Sequence[str], cameras: Sequence[pycolmap.Camera], static: bool) -> int:
    """`ENLARGED` if the images `names` in `root` are small or have few features as they are, else `AS_IT_IS`.

    cameras: one of each lens. static: the capture is photos of a static scene, which are few and are always enlarged.
    """
    if any(enlarged(camera.width, camera.height, static) for camera in cameras):
        return ENLARGED
    looked = [names[i] for i in np.unique(np.linspace(0, len(names) - 1, LOOKED).astype(int))]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "looked.db"
        own = write_cameras(path, [pycolmap.infer_camera_from_image(root / name) for name in looked])
        extract(path, root, looked, own, FEW, lambda *_: None, first_octave=AS_IT_IS)
        ids = image_ids(path, looked)
        with pycolmap.Database.open(path) as database:
            found = [database.num_keypoints_for_image(i) for i in ids]
    return ENLARGED if np.median(found) < FEW else AS_IT_IS


def register(path: Path, root: Path, names: Sequence[str], camera_ids: Sequence[int]) -> None:
    """Registers images in the order of `names`. Extraction would number them as its threads finish, and results would depend on that."""
    with pycolmap.Database.open(path) as database:
        known = {image.name for image in database.read_all_images()}
    for name, camera in zip(names, camera_ids, strict=True):
        if name not in known:
            reader = pycolmap.ImageReaderOptions()
            reader.existing_camera_id = camera
            pycolmap.import_images(path, root, pycolmap.CameraMode.SINGLE, [name], reader)


def verify(
    path: Path, names: Sequence[str], pairs: Sequence[tuple[int, int]], seed: int, report: Report, error: float = 4.0, plane: float = 0.8
) -> None:
    """Estimates the two-view geometry of every pair (indices into `names`) that has matches; pairs that already have one are skipped.

    error: the largest error of an inlier, px. plane: share of the inliers that a homography must explain to be used as the geometry; only
    the matches that it explains are then kept.
    """
    options = pycolmap.TwoViewGeometryOptions()
    options.ransac.random_seed, options.ransac.max_error, options.max_H_inlier_ratio = seed, error, plane
    listing = path.with_suffix(".pairs.txt")
    report("verify", 0, len(pairs))
    for start in range(0, len(pairs), MATCH_CHUNK):
        chunk = pairs[start : start + MATCH_CHUNK]
        list_pairs(listing, names, chunk)
        pycolmap.verify_matches(path, listing, options)
        report("verify", start + len(chunk), len(pairs))


def list_pairs(listing: Path, names: Sequence[str], pairs: Sequence[tuple[int, int]]) -> None:
    """Writes pairs (indices into `names`) as COLMAP reads them."""
    listing.write_text("".join(f"{names[a]} {names[b]}\n" for a, b in pairs), encoding="utf-8")


def image_ids(path: Path, names: Sequence[str]) -> list[int]:
    """The database's id of every image. Raises KeyError with the name of an image that could not be read."""
    with pycolmap.Database.open(path) as database:
        known = {image.name: image.image_id for image in database.read_all_images()}
    return [known[name] for name in names]
