"""Videos and pictures that show all around and do not say so: they are told by their edges, and ordinary ones of that shape are read."""

import cv2
import numpy as np
import pytest
from e4dgs.pipeline import CaptureError
from e4dgs.stages.captures import panorama, recognise
from PIL import Image
from tiny_videos import encode


def shows_all_around(picture):
    return panorama.shows_all_around(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY))


def seen(directions, seed):
    """Colours [...,3] of a made surrounding in ``directions`` [...,3]."""
    rng = np.random.default_rng(seed)
    colours = np.full(directions.shape, 128.0)
    for count, fine, strength in ((6, 2, 40), (12, 8, 30), (30, 20, 25)):
        waves, phase, tint = rng.normal(size=(count, 3)) * fine, rng.uniform(0, 6.3, count), rng.normal(size=(count, 3))
        colours += strength * np.sin(directions @ waves.T + phase) @ tint / np.sqrt(count)
    return np.clip(colours, 0, 255).astype(np.uint8)


def all_around(width, seed, share=1.0):
    """An equirectangular picture, or the middle ``share`` of one stretched to its width."""
    longitude = ((np.arange(width) + 0.5) / width - 0.5) * 2 * np.pi * share
    x, y = np.meshgrid(longitude, np.pi / 2 - (np.arange(width // 2) + 0.5) / (width // 2) * np.pi)
    return seen(np.stack([np.cos(y) * np.sin(x), -np.sin(y), np.cos(y) * np.cos(x)], -1), seed)


def flat_view(width, seed, wide=0.8):
    """Of the same surrounding, up to ``wide`` focal lengths from the middle."""
    x, y = np.meshgrid(np.linspace(-wide, wide, width), np.linspace(-wide / 2, wide / 2, width // 2))
    directions = np.stack([x, y, np.ones_like(x)], -1)
    return seen(directions / np.linalg.norm(directions, axis=-1, keepdims=True), seed)


def on(background, across=slice(100, 400)):
    """An object in front of a picture [256,512,3]."""
    picture = background.copy()
    picture[60:200, across] = flat_view(512, 1)[60:200, across]
    return picture


def ordinary():
    """Pictures that are twice as wide as high and do not show all around, by name."""
    white, lawn = np.full((256, 512, 3), 250, np.uint8), np.linspace(240, 40, 256)[:, None, None] * np.ones((256, 512, 3))
    lawn = np.clip(lawn + np.random.default_rng(0).normal(0, 3, lawn.shape), 0, 255).astype(np.uint8)
    sky = flat_view(512, 4)
    sky[:120] = (120, 170, 250)
    bars = flat_view(512, 2)
    bars[:30] = bars[-30:] = 0
    framed = bars.copy()
    framed[:, :40] = framed[:, -40:] = 0
    mirrored = np.concatenate([bars[:, :256], bars[:, 255::-1]], 1)
    return {
        "flat": flat_view(512, 5),
        "very wide": flat_view(512, 6, 3.0),
        "half of all": all_around(512, 7, 0.5),
        "nearly all": all_around(512, 8, 0.97),
        "sky": sky,
        "studio": on(white),
        "up to the edges": on(white, slice(4, 508)),
        "lawn": on(lawn),
        "bars": bars,
        "framed": framed,
        "mirrored": mirrored,
        "no poles": cv2.resize(all_around(1024, 4)[128:384], (512, 256)),
        "noise": np.random.default_rng(0).integers(0, 255, (256, 512, 3), dtype=np.uint8),
        "grey": np.full((256, 512, 3), 90, np.uint8),
        "black": np.zeros((256, 512, 3), np.uint8),
    }


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("width", [512, 1500])
def test_a_picture_that_goes_on_at_its_other_edge_shows_all_around(width, seed):
    picture = all_around(width, seed)
    assert shows_all_around(picture) and shows_all_around(np.roll(picture, width // 3, 1))
    for quality in (75 if width == 512 else 40, 90):
        assert shows_all_around(cv2.imdecode(cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])[1], 1))


@pytest.mark.parametrize("name", ordinary())
def test_ordinary_pictures_of_that_shape_do_not(name):
    assert not shows_all_around(ordinary()[name])


def test_flat_views_between_black_bars_do_not():
    """Their top and bottom rows are of one colour, so it is the edges that tell."""
    for seed in range(60):
        picture = flat_view(512, seed, np.random.default_rng(seed).uniform(0.3, 2))
        picture[:30] = picture[-30:] = 0
        assert not shows_all_around(picture)


@pytest.mark.parametrize("what", ["seam", "pole"])
def test_how_much_edges_may_differ(what):
    """On either side of the thresholds: brightness that jumps at the seam, and a ramp along the bottom rows."""
    picture = cv2.cvtColor(64 + all_around(512, 0) // 2, cv2.COLOR_RGB2GRAY)
    band = picture[64:-64].astype(float)
    beside = np.mean([np.abs(band[:, a] - band[:, b]).mean() for a, b in ((0, 1), (-1, -2))])
    limit = panorama.SEAM * beside + panorama.NOISE if what == "seam" else panorama.POLE * band.std(1).mean()
    for factor, expected in ((0.8, True), (1.3, False)):
        changed = picture.astype(float)
        if what == "seam":
            edge = changed[:, -1:] + np.sign(130 - changed[:, -1:]) * limit * factor
            changed[:, :1] = edge
            changed[:, 1] += edge[:, 0] - picture[:, 0]  # so that neighbours differ as before
        else:
            changed[-1:] = 128 + np.linspace(-1, 1, 512) * np.sqrt(3) * limit * factor
        assert panorama.shows_all_around(changed.round().astype(np.uint8)) is expected


@pytest.mark.parametrize("suffix", ["mp4", "mkv"])
@pytest.mark.parametrize("keys", [1, 30])
def test_a_video_of_it_is_refused(tmp_path, suffix, keys):
    """Also if it begins with black, and with one key picture alone."""
    views = [np.roll(all_around(512, 0), 9 * k, 1) for k in range(20)]
    black = [views[0] * 0] * (2 if keys == 1 else 0)
    file = encode(tmp_path / f"clip.{suffix}", black + views, options={"qp": "20", "sc_threshold": "0", "g": str(keys)})
    with pytest.raises(CaptureError, match=rf"clip\.{suffix}: a 360-degree video \(its right edge .* v360=e:flat.*; if it is a flat view"):
        recognise(file)


@pytest.mark.parametrize("flat", ["bars", "sky", "studio", "very wide"])
def test_other_videos_of_that_shape_are_read(tmp_path, flat):
    assert recognise(encode(tmp_path / "clip.mp4", [ordinary()[flat]] * 6)).facts["frames"] == 6
    mixed = [all_around(512, 0)] * 2 + [ordinary()[flat]] * 8
    assert recognise(encode(tmp_path / "mixed.mp4", mixed, options={"g": "1"})).facts["frames"] == 10


@pytest.mark.parametrize(
    ("round_about", "refused"), [((0, 1, 2, 3, 4, 5, 6), True), ((3,), False), ((0, 1, 2), False), ((0, 2, 3, 6), True)]
)
def test_so_are_pictures_if_most_of_those_looked_at_are(tmp_path, round_about, refused):
    for k in range(7):
        Image.fromarray(np.roll(all_around(512, 0), 9 * k, 1) if k in round_about else flat_view(512, k)).save(tmp_path / f"{k}.jpg")
    if refused:
        with pytest.raises(
            CaptureError, match=r"0\.jpg: a 360-degree picture \(.*, as in [45] of 5 pictures looked at\).*; if it is a flat"
        ):
            recognise(tmp_path)
    else:
        assert recognise(tmp_path).facts["frames"] == 7
