"""Frames of large videos are not enlarged for features, unless they have few."""

import numpy as np
import pycolmap
import pytest
from e4dgs.vision.sfm.pairs import SMALL, enlarged
from e4dgs.vision.sfm.worker.features.database import AS_IT_IS, ENLARGED, FEW, extract, first_octave, image_ids, write_cameras
from PIL import Image


def write(folder, width, blobs):
    """Three pictures of 4 px squares at random positions; at full size, SIFT finds about one feature for each."""
    rng = np.random.default_rng(0)
    for i in range(3):
        picture = np.full((width // 2, width), 40, np.uint8)
        for y, x in zip(rng.integers(8, width // 2 - 12, blobs), rng.integers(8, width - 12, blobs), strict=True):
            picture[y : y + 5, x : x + 5] = rng.integers(90, 255)
        Image.fromarray(picture).save(folder / f"{i}.png")
    names = [f"{i}.png" for i in range(3)]
    return names, [pycolmap.infer_camera_from_image(folder / names[0])]


@pytest.mark.parametrize(("longer", "static", "expected"), [(SMALL - 1, False, True), (SMALL, False, False), (4000, True, True)])
def test_small_frames_and_photos_of_static_scenes_are_enlarged(longer, static, expected):
    assert enlarged(longer, 300, static) == expected
    assert enlarged(300, longer, static) == expected


@pytest.mark.parametrize(("blobs", "expected"), [(4 * FEW, AS_IT_IS), (FEW // 8, ENLARGED)])
def test_a_large_video_is_enlarged_only_where_it_has_few_features(tmp_path, blobs, expected):
    names, cameras = write(tmp_path, SMALL, blobs)
    assert first_octave(tmp_path, names, cameras, False) == expected


def test_a_small_video_is_enlarged_however_many_features_it_has(tmp_path):
    names, cameras = write(tmp_path, SMALL - 2, 4 * FEW)
    assert first_octave(tmp_path, names, cameras, False) == ENLARGED


def test_an_enlarged_picture_shows_finer_features(tmp_path):
    noise = np.random.default_rng(0).integers(0, 255, (200, 400), dtype=np.uint8)
    Image.fromarray(noise).save(tmp_path / "noise.png")
    names, cameras = ["noise.png"], [pycolmap.infer_camera_from_image(tmp_path / "noise.png")]
    smallest = []
    for octave in (AS_IT_IS, ENLARGED):
        path = tmp_path / f"{octave}.db"
        extract(path, tmp_path, names, write_cameras(path, cameras), 8192, lambda *_: None, first_octave=octave)
        (first,) = image_ids(path, names)
        with pycolmap.Database.open(path) as database:
            scales = np.linalg.norm(database.read_keypoints(first)[:, 2:4], axis=1)  # rows of x, y and an affine shape
        smallest.append(scales.min())
    assert smallest[0] > 1.5 * smallest[1]
