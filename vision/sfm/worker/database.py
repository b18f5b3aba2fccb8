"""The COLMAP database of one run: cameras, features and matches, filled so that a killed run resumes where it stopped.

Only the worker process imports this module, since it imports pycolmap.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import pycolmap

from ....pipeline import thread_count

Report = Callable[[str, int, int], None]  # phase, done, total

EXTRACT_CHUNK = 8  # images per call; a killed run loses at most this many
MATCH_CHUNK = 64  # pairs per call


def write_cameras(path: Path, cameras: Sequence[pycolmap.Camera]) -> list[int]:
    """Writes cameras and returns their ids in the given order. Since ids are 1, 2, ..., a resumed run finds its cameras again."""
    with pycolmap.Database.open(path) as database:
        for index in range(database.num_cameras(), len(cameras)):
            database.write_camera(cameras[index])
    return list(range(1, len(cameras) + 1))


def extract(
    path: Path, root: Path, names: Sequence[str], camera_ids: Sequence[int], max_features: int, report: Report, masks: str | None = None
) -> None:
    """Extracts SIFT features of every image; `camera_ids[i]` is the camera of `names[i]`. Images that have features are skipped. masks: a
    folder; if it has NAME.png, the image NAME gets no features where that is black."""
    _register(path, root, names, camera_ids)
    with pycolmap.Database.open(path) as database:
        have = {image.name for image in database.read_all_images() if database.exists_descriptors(image.image_id)}
    options = pycolmap.FeatureExtractionOptions()
    options.sift.max_num_features, options.num_threads = max_features, thread_count()
    done = len(have)
    report("features", done, len(names))
    for camera in sorted(set(camera_ids)):
        reader = pycolmap.ImageReaderOptions()
        reader.existing_camera_id = camera
        if masks is not None:
            reader.mask_path = masks
        todo = [name for name, c in zip(names, camera_ids, strict=True) if c == camera and name not in have]
        for start in range(0, len(todo), EXTRACT_CHUNK):
            chunk = todo[start : start + EXTRACT_CHUNK]
            pycolmap.extract_features(path, root, chunk, pycolmap.CameraMode.SINGLE, reader, options)
            done += len(chunk)
            report("features", done, len(names))


def _register(path: Path, root: Path, names: Sequence[str], camera_ids: Sequence[int]) -> None:
    """Registers images in the order of `names`. Extraction would number them as its threads finish, and results would depend on that."""
    with pycolmap.Database.open(path) as database:
        known = {image.name for image in database.read_all_images()}
    for name, camera in zip(names, camera_ids, strict=True):
        if name not in known:
            reader = pycolmap.ImageReaderOptions()
            reader.existing_camera_id = camera
            pycolmap.import_images(path, root, pycolmap.CameraMode.SINGLE, [name], reader)


def match(path: Path, names: Sequence[str], pairs: Sequence[tuple[int, int]], seed: int, verify: bool, report: Report) -> None:
    """Matches the pairs (indices into `names`). `verify` also estimates the two-view geometry of each, which needs no poses."""
    matching = pycolmap.FeatureMatchingOptions()
    matching.skip_geometric_verification, matching.num_threads = not verify, thread_count()
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = seed
    listing = path.with_suffix(".pairs.txt")
    pairing = pycolmap.ImportedPairingOptions()
    pairing.match_list_path = listing
    report("matches", 0, len(pairs))
    for start in range(0, len(pairs), MATCH_CHUNK):
        chunk = pairs[start : start + MATCH_CHUNK]
        _list_pairs(listing, names, chunk)
        pycolmap.match_image_pairs(path, matching_options=matching, pairing_options=pairing, verification_options=verification)
        report("matches", start + len(chunk), len(pairs))


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
        _list_pairs(listing, names, chunk)
        pycolmap.verify_matches(path, listing, options)
        report("verify", start + len(chunk), len(pairs))


def _list_pairs(listing: Path, names: Sequence[str], pairs: Sequence[tuple[int, int]]) -> None:
    listing.write_text("".join(f"{names[a]} {names[b]}\n" for a, b in pairs), encoding="utf-8")


def image_ids(path: Path, names: Sequence[str]) -> list[int]:
    """The database's id of every image. Raises KeyError with the name of an image that could not be read."""
    with pycolmap.Database.open(path) as database:
        known = {image.name: image.image_id for image in database.read_all_images()}
    return [known[name] for name in names]
