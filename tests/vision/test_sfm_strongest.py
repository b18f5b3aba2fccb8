"""The strongest features of long videos lie where COLMAP's do, off masks, and a killed extraction resumes."""

import cv2
import numpy as np
import pycolmap
import pytest
from e4dgs.vision.sfm.pairs import MANY, image_pairs, many
from e4dgs.vision.sfm.worker.features.database import extract, image_ids, write_cameras
from e4dgs.vision.sfm.worker.features.matching import match
from e4dgs.vision.sfm.worker.features.strongest import extract_strongest
from PIL import Image

MOST = 300


@pytest.fixture
def pictures(tmp_path):
    """Ten pictures of the same smooth noise, moved by 3 px each."""
    noise = np.random.default_rng(0).normal(size=(300, 400))
    blurred = sum(cv2.GaussianBlur(noise, (0, 0), sigma) * sigma for sigma in (1.5, 3.0, 6.0))
    grey = np.clip(128 + 60 * blurred / blurred.std(), 0, 255).astype(np.uint8)
    (tmp_path / "images").mkdir()
    for i in range(10):
        Image.fromarray(grey[:240, 3 * i : 3 * i + 320]).save(tmp_path / "images" / f"{i}.png")
    return tmp_path


def found(folder, name, extractor, names, *options):
    """Places of the features of every image in a new database."""
    path, root = folder / name, folder / "images"
    cameras = write_cameras(path, [pycolmap.infer_camera_from_image(root / names[0])]) * len(names)
    extractor(path, root, names, cameras, *options)
    return path, read(path, names)


def read(path, names):
    with pycolmap.Database.open(path) as database:
        return [np.asarray(database.read_keypoints(i))[:, :2] for i in image_ids(path, names)]


def nearest(a, b):
    return np.linalg.norm(a[:, None] - b[None], axis=2).min(axis=1)


def test_only_long_videos_have_fewer_features():
    assert not many(MANY, False)
    assert many(MANY + 1, False)
    assert not many(10 * MANY, True)


def test_long_videos_leave_out_steps_that_are_no_power_of_two():
    short, long = set(image_pairs("sequential", MANY)), set(image_pairs("sequential", MANY + 1))
    for step in (1, 2, 3, 4):
        every = {(a, a + step) for a in range(MANY - step)}
        assert every <= short
        assert (every <= long) == (step != 3)
    assert len(long) < 0.75 * len(short)


def test_features_lie_where_colmap_finds_them(pictures):
    _, (strong,) = found(pictures, "strong.db", extract_strongest, ["0.png"], MOST, lambda *_: None)
    _, (all_of_them,) = found(pictures, "colmap.db", extract, ["0.png"], 8192, lambda *_: None)
    assert MOST / 2 < len(strong) <= MOST < len(all_of_them)
    distance = nearest(strong, all_of_them)
    assert np.median(distance) < 0.05  # half a pixel between the two conventions would show
    close = distance < 0.3
    assert close.mean() > 0.9
    nearby = all_of_them[np.linalg.norm(strong[close][:, None] - all_of_them[None], axis=2).argmin(axis=1)]
    assert np.abs((strong[close] - nearby).mean(axis=0)).max() < 0.02


def test_they_match_and_follow_the_pictures(pictures):
    names = ["0.png", "4.png"]
    path, (first, second) = found(pictures, "two.db", extract_strongest, names, MOST, lambda *_: None)
    match(path, names, [(0, 1)], 0, False, lambda *_: None)
    with pycolmap.Database.open(path) as database:
        rows = np.asarray(database.read_matches(*image_ids(path, names))).astype(int)
    assert len(rows) > MOST / 3
    way = first[rows[:, 0]] - second[rows[:, 1]]
    assert np.median(np.abs(way - (12, 0)).max(axis=1)) < 0.05


def test_no_features_where_the_mask_is_black(pictures):
    mask = np.full((240, 320), 255, np.uint8)
    mask[:, :160] = 0
    (pictures / "masks").mkdir()
    Image.fromarray(mask).save(pictures / "masks" / "0.png.png")
    _, (masked, free) = found(pictures, "a.db", extract_strongest, ["0.png", "1.png"], MOST, lambda *_: None, str(pictures / "masks"))
    assert len(masked)
    assert masked[:, 0].min() >= 159
    assert free[:, 0].min() < 100


def test_a_killed_extraction_resumes_with_the_same_result(pictures):
    names = [f"{i}.png" for i in range(10)]
    _, whole = found(pictures, "whole.db", extract_strongest, names, MOST, lambda *_: None)
    seen = []

    def killed(phase, done, total):
        seen.append(done)
        if done == 8:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        found(pictures, "killed.db", extract_strongest, names, MOST, killed)
    seen.clear()
    _, resumed = found(pictures, "killed.db", extract_strongest, names, MOST, lambda phase, done, total: seen.append(done))
    assert seen == [8, 10]
    for a, b in zip(whole, resumed, strict=True):
        np.testing.assert_array_equal(a, b)
