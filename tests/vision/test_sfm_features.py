"""Images that show enough features are not enlarged to find more."""

import cv2
import numpy as np
import pytest
from e4dgs.vision.sfm.worker import database

pycolmap = pytest.importorskip("pycolmap")


def pictures(folder, dots: int) -> list[str]:
    """Three pictures with as many dots each, at other places."""
    rng = np.random.default_rng(dots)
    names = [f"{k}.png" for k in range(3)]
    for name in names:
        image = np.full((240, 320), 128, np.uint8)
        places = np.stack(np.meshgrid(np.arange(23), np.arange(17)), -1).reshape(-1, 2)[:dots] * 13 + 10
        for x, y in places + rng.integers(-2, 3, places.shape):
            cv2.circle(image, (int(x), int(y)), 3, int(rng.integers(0, 2)) * 255, -1)
        assert cv2.imwrite(str(folder / name), image)
    return names


@pytest.mark.parametrize(("dots", "enough"), [(60, False), (390, True)])
def test_features_are_counted_at_the_pictures_own_size(tmp_path, monkeypatch, dots, enough):
    monkeypatch.setattr(database, "ENOUGH", 250)
    names = pictures(tmp_path, dots)
    assert database.rich(tmp_path, tmp_path, names, 8192) is enough
    assert sorted(p.name for p in tmp_path.iterdir()) == names, "the probe leaves nothing"


def test_an_enlarged_picture_shows_more(tmp_path):
    names = pictures(tmp_path, 150)[:1]
    counts = []
    for enlarged in (False, True):
        path = tmp_path / f"{enlarged}.db"
        cameras = database.write_cameras(path, [pycolmap.infer_camera_from_image(tmp_path / names[0])])
        database.extract(path, tmp_path, names, cameras, 8192, lambda *_: None, enlarged=enlarged)
        with pycolmap.Database.open(path) as stored:
            counts.append(len(stored.read_keypoints(1)))
    assert counts[1] > counts[0] > 100
