"""What the matches show about the camera's motion, and sentences for people about a reconstruction. Runs in the worker process: imports
pycolmap."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from ..coverage import frames_named
from ..impossible_points import Purged
from ..pose_agreement import FreePair

VERIFIED = 15  # inlier matches that a pair needs to count; the mapper's own limit
WORTH = 0.01  # of the observations; a smaller loss is not worth a sentence
_TURNED = ("PLANAR", "PANORAMIC", "PLANAR_OR_PANORAMIC")


@dataclass(frozen=True)
class Survey:
    """What the database holds about n images.

    features [n]: count in each image; places [n] of [N, 2] px: their positions; matches {(a, b): [M, 2]}: feature numbers of the inliers,
    for pairs with at least 15. facts are for messages: `verified` (number of such pairs), `matched` [n] (most matches of each image in one
    of them), `flat` (share of them that one homography explains: a camera that only turned, or a single plane), `shift` (median distance
    that matches move in a pair, 90th percentile over the pairs, as a share of the longer side; 0 without pairs).
    """

    features: list[int]
    places: list[np.ndarray]
    matches: dict[tuple[int, int], np.ndarray]
    facts: dict[str, Any]


def survey(path: Path, names: Sequence[str], pairs: Sequence[Sequence[int]]) -> Survey:
    """Reads the features and the verified matches of the pairs (indices into `names`)."""
    matched = np.zeros(len(names), int)
    matches, flat, shift = {}, [], []
    with pycolmap.Database.open(path) as database:
        images = {image.name: image for image in database.read_all_images()}
        sizes = {camera.camera_id: max(camera.width, camera.height) for camera in database.read_all_cameras()}
        places = [np.asarray(database.read_keypoints(images[name].image_id), np.float64)[:, :2] for name in names]
        for a, b in sorted((int(a), int(b)) for a, b in pairs):
            first, second = images[names[a]], images[names[b]]
            if not database.exists_two_view_geometry(first.image_id, second.image_id):
                continue
            geometry = database.read_two_view_geometry(first.image_id, second.image_id)
            inliers = np.asarray(geometry.inlier_matches).astype(np.int64)
            if len(inliers) < VERIFIED:
                continue
            matches[a, b] = inliers
            matched[[a, b]] = np.maximum(matched[[a, b]], len(inliers))
            flat.append(pycolmap.TwoViewGeometryConfiguration(geometry.config).name in _TURNED)
            way = np.linalg.norm(places[a][inliers[:, 0]] - places[b][inliers[:, 1]], axis=1)
            shift.append(float(np.median(way)) / sizes[first.camera_id])
    facts = {
        "verified": len(flat),
        "matched": matched.tolist(),
        "flat": float(np.mean(flat)) if flat else 0.0,
        "shift": float(np.percentile(shift, 90)) if shift else 0.0,
    }
    return Survey([len(place) for place in places], places, matches, facts)


def free_pairs(path: Path, names: Sequence[str], pairs: Sequence[Sequence[int]]) -> Iterator[FreePair]:
    """All matches of the verified pairs (indices into `names`), with the fundamental matrix that each pair has on its own, if any."""
    with pycolmap.Database.open(path) as database:
        ids = {image.name: image.image_id for image in database.read_all_images()}
        places = [np.asarray(database.read_keypoints(ids[name]), np.float32)[:, :2] for name in names]
        for a, b in sorted((int(a), int(b)) for a, b in pairs):
            if not database.exists_two_view_geometry(ids[names[a]], ids[names[b]]):
                continue
            geometry = database.read_two_view_geometry(ids[names[a]], ids[names[b]])
            if len(geometry.inlier_matches) < VERIFIED:
                continue
            own = None if geometry.F is None or not np.any(geometry.F) else np.asarray(geometry.F)
            matches = np.asarray(database.read_matches(ids[names[a]], ids[names[b]])).astype(np.int64)
            yield a, b, places[a][matches[:, 0]], places[b][matches[:, 1]], own


def tell(
    names: Sequence[str], observations: int, lost: Sequence[Purged], undone: str | None, merged: Sequence[str], again: Sequence[str]
) -> list[str]:
    """Sentences about what was removed (out of `observations`), undone, and reclaimed; empty if nothing was."""
    index = {name: i for i, name in enumerate(names)}
    said = []
    strays, points = sum(p.observations for p in lost), sum(p.points for p in lost)
    if strays + points > WORTH * observations:
        said.append(f"removed: {points} points without depth or behind a camera, and {strays} of {observations} observations")
    images = sorted({index[name] for p in lost for name in p.images} - {index[name] for name in (*merged, *again)})
    if images:
        said.append(f"{frames_named(images)}: a pose was found but dropped, because hardly any sound point supports it")
    if merged:
        said.append(f"{frames_named([index[name] for name in merged])}: joined from another part of the reconstruction")
    if again:
        said.append(f"{frames_named([index[name] for name in again])}: registered when tried again with fewer matches")
    if undone is not None:
        said.append(f"the last adjustment was undone: {undone}")
    return said
