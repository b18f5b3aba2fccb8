"""Triangulates points from images whose cameras are known. Runs in the worker process: imports pycolmap."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from ....pipeline import thread_count
from ..epipolar import fundamental, guided_matches
from .features import database as db


def triangulate_known(request: dict[str, Any], report: db.Report) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Triangulates points from the images of `request` (pinhole, `K` [n,3,3], `cam_from_world` [n,4,4]) and its `pairs`.

    Returns arrays `points` [P,3] float64, `colors` [P,3] uint8, `errors` [P] px, `tracks` [P] (views of each point). Every point is in
    front of all its cameras, within `max_error` px of its features in each, and seen under at least `min_angle` degrees.
    """
    folder, root, names = Path(request["folder"]), Path(request["root"]), list(request["names"])
    K, poses = np.array(request["K"], np.float64), np.array(request["cam_from_world"], np.float64)
    path = folder / "database.db"
    pycolmap.set_random_seed(int(request["seed"]))

    distinct, camera_of = np.unique(K.reshape(len(K), 9), axis=0, return_inverse=True)
    camera_of = camera_of.reshape(-1)
    cameras = [_pinhole(k.reshape(3, 3), request["width"], request["height"]) for k in distinct]
    ids = db.write_cameras(path, cameras)
    db.extract(path, root, names, [ids[c] for c in camera_of], int(request["max_features"]), report)
    image_ids = db.image_ids(path, names)
    _match(path, image_ids, K, poses, request["pairs"], float(request["max_error"]), report)

    report("points", 0, 1)
    with pycolmap.Database.open(path) as database:
        known = _posed(database, image_ids, poses)
    model = pycolmap.triangulate_points(known, path, root, folder, True, _options(request))
    model.extract_colors_for_all_images(root)
    arrays = _arrays(model, {i: n for n, i in enumerate(image_ids)}, K, poses, request)
    report("points", 1, 1)
    return arrays, {"images": len(names), "pairs": len(request["pairs"])}


def _pinhole(K: np.ndarray, width: int, height: int) -> pycolmap.Camera:
    camera = pycolmap.Camera.create_from_model_name(0, "PINHOLE", K[0, 0], width, height)
    camera.params = [K[0, 0], K[1, 1], K[0, 2], K[1, 2]]
    return camera


def _match(
    path: Path, image_ids: list[int], K: np.ndarray, poses: np.ndarray, pairs: list[list[int]], error: float, report: db.Report
) -> None:
    """Writes guided matches of every pair as verified: the geometry is known, so there is nothing to estimate."""
    report("matches", 0, len(pairs))
    with pycolmap.Database.open(path) as database:
        features = {}
        for n in sorted({n for pair in pairs for n in pair}):
            data = database.read_descriptors(image_ids[n]).data.astype(np.float32)
            unit = data / np.maximum(np.linalg.norm(data, axis=1, keepdims=True), 1e-6)
            features[n] = np.asarray(database.read_keypoints(image_ids[n]), np.float64)[:, :2], unit

        def match(pair: list[int]) -> tuple[np.ndarray, np.ndarray]:
            a, b = pair
            F = fundamental(K[a], K[b], poses[a], poses[b])
            return F, guided_matches(*features[a], *features[b], F, error)

        with ThreadPoolExecutor(thread_count(8)) as pool:
            for done, ((a, b), (F, matches)) in enumerate(zip(pairs, pool.map(match, pairs)), 1):
                geometry = pycolmap.TwoViewGeometry()
                geometry.config = pycolmap.TwoViewGeometryConfiguration.CALIBRATED
                geometry.inlier_matches = matches
                geometry.F = F
                database.write_matches(image_ids[a], image_ids[b], matches)
                database.write_two_view_geometry(image_ids[a], image_ids[b], geometry)
                if done % 16 == 0 or done == len(pairs):
                    report("matches", done, len(pairs))


def _posed(database: pycolmap.Database, image_ids: list[int], poses: np.ndarray) -> pycolmap.Reconstruction:
    model = pycolmap.Reconstruction()
    for camera in database.read_all_cameras():
        model.add_camera(camera)
    for rig in database.read_all_rigs():
        model.add_rig(rig)
    number = {image_id: n for n, image_id in enumerate(image_ids)}
    images = {image.image_id: image for image in database.read_all_images()}
    for frame in database.read_all_frames():
        (image_id,) = [data.id for data in frame.data_ids]
        frame.rig_from_world = pycolmap.Rigid3d(poses[number[image_id]][:3])
        model.add_frame(frame)
        images[image_id].frame_id = frame.frame_id
        model.add_image(images[image_id])
        model.register_frame(frame.frame_id)
    return model


def _options(request: dict[str, Any]) -> pycolmap.IncrementalPipelineOptions:
    options = pycolmap.IncrementalPipelineOptions()
    error, angle = float(request["max_error"]), float(request["min_angle"])
    options.random_seed = options.triangulation.random_seed = int(request["seed"])
    options.num_threads = options.mapper.num_threads = 1  # several add up the adjustment's terms in another order each time
    options.extract_colors = False
    options.mapper.filter_max_reproj_error = error
    options.mapper.filter_min_tri_angle = angle
    options.triangulation.min_angle = angle
    options.triangulation.merge_max_reproj_error = error
    options.triangulation.complete_max_reproj_error = error
    options.triangulation.ignore_two_view_tracks = int(request["min_track"]) > 2
    return options


def _arrays(
    model: pycolmap.Reconstruction, number: dict[int, int], K: np.ndarray, poses: np.ndarray, request: dict[str, Any]
) -> dict[str, np.ndarray]:
    """The points that pass. All limits are checked again here from the features, without relying on COLMAP."""
    keypoints = {i: np.array([p.xy for p in model.image(i).points2D]).reshape(-1, 2) for i in number}
    centres = -np.einsum("nji,nj->ni", poses[:, :3, :3], poses[:, :3, 3])
    points, colors, errors, tracks = [], [], [], []
    for key in sorted(model.points3D):
        point = model.points3D[key]
        elements = point.track.elements
        if len(elements) < int(request["min_track"]):
            continue
        views = np.array([number[e.image_id] for e in elements])
        xy = np.array([keypoints[e.image_id][e.point2D_idx] for e in elements])
        local = np.einsum("nij,j->ni", poses[views][:, :3, :3], point.xyz) + poses[views][:, :3, 3]
        if (local[:, 2] <= 0).any():
            continue
        projected = np.einsum("nij,nj->ni", K[views], local)
        error = np.linalg.norm(projected[:, :2] / projected[:, 2:] - xy, axis=1)
        rays = point.xyz - centres[views]
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        angle = np.degrees(np.arccos(np.clip((rays @ rays.T).min(), -1, 1)))
        if error.max() > float(request["max_error"]) or angle < float(request["min_angle"]):
            continue
        points.append(point.xyz)
        colors.append(point.color)
        errors.append(error.mean())
        tracks.append(len(elements))
    return {
        "points": np.array(points, np.float64).reshape(-1, 3),
        "colors": np.array(colors, np.uint8).reshape(-1, 3),
        "errors": np.array(errors, np.float64),
        "tracks": np.array(tracks, np.int64),
    }
