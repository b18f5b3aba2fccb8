"""The web player's data: written and read back within the stated error, and nothing that a file holds is believed."""

import json
import struct
import zlib

import numpy as np
import pytest
import torch
from e4dgs.rasterizer import rasterize
from e4dgs.scene.formats.web.arrays import Coded, decode, encode
from e4dgs.scene.formats.web.container import MOST_DATA, pack, unpack
from e4dgs.scene.formats.web.layout import shapes_of
from e4dgs.scene.formats.web.scene import WebScene
from e4dgs.scene.formats.web.windows import file_of, join, read, split
from e4dgs.stages.exports.web_scene import web_scene
from made_models import FRAMES, MOTIONS, camera, made

ABOUT = {"seconds": 1.0, "up": [0.0, -1.0, 0.0], "target": [0.0, 0.0, 0.0], "cameras": []}
PIXEL = 3.0 / 150


def scene_of(motion, **more):
    return web_scene(made(motion, **{"gaussians": 200, "convexes": 30} | more), FRAMES, PIXEL, ABOUT)


@pytest.mark.parametrize("delta", [False, True])
@pytest.mark.parametrize(("shape", "step"), [((7, 3), 0.01), ((4, 5, 2), 0.3), ((0, 3), 0.1), ((5, 0, 1), 0.1), ((3, 1, 1), 1e-9)])
def test_numbers_come_back_within_half_a_step(shape, step, delta):
    values = np.random.default_rng(0).normal(size=shape) * [1.0, 50.0, 0.0][: shape[-1]]
    coded = encode("x", values, step, delta)
    assert len(coded.data) == values.size * coded.planes
    back = decode(coded).reshape(shape)
    steps = np.array(coded.step)  # larger than asked for only where four bytes would not do
    assert np.all(np.abs(back - values) <= steps / 2 * (1 + 1e-9))
    assert step < 1e-6 or np.allclose(steps, step)


def test_floats_come_back_to_the_bit():
    values = np.random.default_rng(0).normal(size=(9, 2, 3)).astype(np.float32)
    assert np.array_equal(decode(encode("x", values, None)), values)


def test_a_value_that_is_not_finite_is_refused():
    with pytest.raises(ValueError, match="x: a value is not finite"):
        encode("x", np.array([[np.nan]]), 0.1)


@pytest.mark.parametrize("motion", MOTIONS)
def test_every_array_comes_back_within_half_its_step(motion):
    scene, steps = scene_of(motion)
    back = WebScene.from_bytes(scene.to_bytes(steps))
    assert back.header == {**scene.header, "arrays": back.header["arrays"]}
    for name in shapes_of(scene.header):
        step = np.broadcast_to(steps.get(name, 1.0 if name.endswith("links") else 0.0), scene.arrays[name].shape[2:])
        error = np.abs(back.arrays[name] - scene.arrays[name]).reshape(-1, len(step)).max(0, initial=0)
        assert np.all(error <= step / 2 + 1e-6 * np.abs(scene.arrays[name]).max(initial=0) + 1e-12), name


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("antialiased", [True, False])
def test_the_file_renders_like_the_model(motion, antialiased):
    model = made(motion, antialiased=antialiased)
    scene, steps = web_scene(model, FRAMES, PIXEL, ABOUT)
    files = [WebScene.from_bytes(scene.to_bytes()), WebScene.from_bytes(scene.to_bytes(steps))]
    for time in (0.0, 0.37, 1.0):
        view = camera(2.0 * time)
        with torch.no_grad():
            truth = rasterize(view, *model.at(time), torch.tensor(model.background), antialiased=antialiased).color.clamp(0, 1)
        exact, written = (float(-10 * (one.render(view, time).color.clamp(0, 1) - truth).square().mean().log10()) for one in files)
        assert exact > 50 and written > 40, (exact, written)


def test_what_is_not_drawn_is_left_out():
    model = made("static", gaussians=50, convexes=4)
    with torch.no_grad():
        model.gaussians.opacity_logits[:10] = -20.0
        model.gaussians.means[10] = torch.nan
    scene, _ = web_scene(model, 1, PIXEL, ABOUT)
    assert scene.header["gaussians"] == [39, 0] and scene.header["convexes"] == [4, 0]


def test_an_empty_model_is_a_file_too():
    scene, steps = scene_of("static", gaussians=0, convexes=0)
    back = WebScene.from_bytes(scene.to_bytes(steps))
    assert float(back.render(camera(0.0), 0.5).alpha.max()) == 0


def changed(data: bytes, change) -> bytes:
    """The file with a header that ``change`` has altered in place."""
    length = struct.unpack("<I", data[8:12])[0]
    header = json.loads(data[12 : 12 + length])
    change(header)
    said = json.dumps(header).encode()
    return data[:8] + struct.pack("<I", len(said)) + said + data[12 + length :]


HOSTILE = {
    "no bytes": lambda d: b"",
    "another kind of file": lambda d: b"\x89PNG" + d[4:],
    "only its beginning": lambda d: d[:9],
    "another version": lambda d: d[:4] + struct.pack("<I", 99) + d[8:],
    "a header of 4 GB": lambda d: d[:8] + struct.pack("<I", 2**32 - 1) + d[12:],
    "a header that is no JSON": lambda d: d[:12] + b"\xff" + d[13:],
    "deep JSON": lambda d: d[:8] + struct.pack("<I", 200_000) + b"[" * 200_000,
    "cut data": lambda d: d[:-20],
    "data and more": lambda d: d + b"more",
    "flipped data": lambda d: d[:-400] + bytes([d[-400] ^ 255]) + d[-399:],
    "an array of 2^60": lambda d: changed(d, lambda h: h["arrays"][0].update(shape=[2**30, 2**30, 1])),
    "a negative shape": lambda d: changed(d, lambda h: h["arrays"][0].update(shape=[-1, 1, 3])),
    "a shape of text": lambda d: changed(d, lambda h: h["arrays"][0].update(shape="big")),
    "nine planes": lambda d: changed(d, lambda h: h["arrays"][0].update(planes=9)),
    "infinite steps": lambda d: changed(d, lambda h: h["arrays"][0].update(step=[1e999] * 3)),
    "two arrays of one name": lambda d: changed(d, lambda h: h["arrays"][1].update(name="g_means")),
    "an array less": lambda d: changed(d, lambda h: h["arrays"].pop()),
    "more Gaussians than rows": lambda d: changed(d, lambda h: h.update(gaussians=[10**6, 1])),
    "an unknown motion": lambda d: changed(d, lambda h: h.update(motion="dance")),
    "a near plane behind": lambda d: changed(d, lambda h: h.update(near=-1)),
    "a camera of text": lambda d: changed(d, lambda h: h.update(cameras=["here"])),
    "fewer nodes than links": lambda d: relinked(d),
    "a true number": lambda d: changed(d, lambda h: h.update(frames=True)),
}


def relinked(data: bytes) -> bytes:
    scene = WebScene.from_bytes(data)
    scene.arrays["g_links"] = scene.arrays["g_links"] + 1000
    return scene.to_bytes({})


@pytest.fixture(scope="module")
def file() -> bytes:
    scene, steps = scene_of("nodes", gaussians=60, convexes=6)
    return scene.to_bytes(steps)


@pytest.mark.parametrize("what", HOSTILE)
def test_a_hostile_file_is_refused_in_words(what, file):
    with pytest.raises(ValueError) as error:
        WebScene.from_bytes(HOSTILE[what](file))
    assert len(str(error.value)) < 200


def test_a_file_that_unpacks_to_more_than_it_says_is_stopped():
    bomb = pack({"x": 1}, [])
    bomb = bomb[: bomb.index(b"}") + 1] + zlib.compress(bytes(1 << 26))
    with pytest.raises(ValueError, match="damaged or cut short"):
        unpack(bomb)
    assert MOST_DATA <= 1 << 30


def test_the_same_model_gives_the_same_bytes():
    first, second = (scene.to_bytes(steps) for scene, steps in (scene_of("lives"), scene_of("lives")))
    assert first == second and isinstance(encode("x", np.zeros((1, 1)), 1.0), Coded)


@pytest.fixture(scope="module")
def long_clip() -> bytes:
    """Eight seconds, in which two of three movers are seen for half a second or less."""
    model = made("lives", gaussians=200, convexes=30, degree=1)
    with torch.no_grad():
        for one in (model.gaussians, model.convexes):
            one.log_spans[torch.arange(len(one)) % 3 > 0] -= 3.5
    scene, steps = web_scene(model, FRAMES, PIXEL, ABOUT | {"seconds": 8.0})
    return scene.to_bytes(steps)


def test_windows_hold_every_number_once_and_all_that_is_seen_at_their_times(long_clip):
    files = split(long_clip)
    whole, back, first = WebScene.from_bytes(long_clip), join(files), WebScene.from_bytes(files[0])
    windows = first.header["windows"]
    assert len(files) == len(windows) + 1 == 5 and len(files[0]) < 0.75 * len(long_clip)
    assert {k: v for k, v in back.header.items() if k != "arrays"} == {k: v for k, v in whole.header.items() if k != "arrays"}
    for name, values in whole.arrays.items():
        rows = [np.sort(one.reshape(len(one), -1), 0) for one in (values, back.arrays[name])]
        assert np.allclose(*rows, rtol=0, atol=1e-9), name
    for time in (0.0, 0.3, 0.62, 1.0):
        shown = [one.render(camera(1.0), time).color for one in (whole, back)]
        assert float((shown[0] - shown[1]).abs().max()) < 1e-4, time
        outside = [WebScene.from_bytes(f).at(time) for f, (start, end, *_) in zip(files[1:], windows) if not start <= time <= end]
        assert len(outside) >= 2
        assert float(torch.cat([kind.opacities for part in outside for kind in part]).max()) < 1 / 255, time


def test_a_folder_of_windows_is_read_and_what_is_missing_or_foreign_is_said(long_clip, tmp_path):
    first, files = tmp_path / "scene.e4dw", split(long_clip)
    for k, data in enumerate(files):
        (file_of(first, k) if k else first).write_bytes(data)
    assert read(first).header["gaussians"] == WebScene.from_bytes(long_clip).header["gaussians"]
    file_of(first, 2).write_bytes(files[3])
    with pytest.raises(ValueError, match="file 2 of the scene belongs to another scene"):
        read(first)
    file_of(first, 2).write_bytes(files[2][:-20])
    with pytest.raises(ValueError, match="file 2 of the scene: its data are damaged"):
        read(first)
    file_of(first, 2).unlink()
    with pytest.raises(FileNotFoundError, match=r"scene-2\.e4dw"):
        read(first)
    for wrong in ("all", [[0, 1, 2]], [[0, 1, -1, 0]], [[0, None, 1, 0]]):
        with pytest.raises(ValueError, match="windows"):
            WebScene.from_bytes(changed(files[0], lambda h, wrong=wrong: h.update(windows=wrong)))


def test_short_clips_and_motions_that_never_end_stay_one_file(file, long_clip):
    assert split(file) == [file]
    short = changed(long_clip, lambda h: h.update(seconds=3.0))
    assert split(short) == [short]
