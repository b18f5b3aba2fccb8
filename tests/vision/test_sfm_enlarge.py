"""Frames of large videos are not enlarged for features, unless they have few."""

import numpy as np
import pycolmap
import pytest
from e4dgs.vision.sfm.pairs import SMALL, enlarged
from e4dgs.vision.sfm.worker.database import AS_IT_IS, ENLARGED, FEW, first_octave
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


@pytest.mark.parametrize(
    ("blobs", "static", "expected"), [(4 * FEW, False, AS_IT_IS), (FEW // 8, False, ENLARGED), (4 * FEW, True, ENLARGED)]
)
def test_a_large_video_is_enlarged_only_where_it_has_few_features(tmp_path, blobs, static, expected):
    names, cameras = write(tmp_path, SMALL, blobs)
    assert first_octave(tmp_path, names, cameras, static) == expected


def test_a_small_video_is_enlarged_however_many_features_it_has(tmp_path):
    names, cameras = write(tmp_path, SMALL - 2, 4 * FEW)
    assert first_octave(tmp_path, names, cameras, False) == ENLARGED
