"""Depth maps of every kind of file are read, and what is broken or hostile is one message that names the file."""

import struct

import numpy as np
import pytest
from e4dgs.pipeline import CaptureError
from e4dgs.vision.depth import files
from e4dgs.vision.depth.files import read_depth
from e4dgs.vision.depth.lzfse_files import promised_bytes
from PIL import Image

SHAPE = (12, 16)  # of the picture


def test_numpy_files_are_read_and_colours_are_not(tmp_path):
    values = np.array([[1.5, np.nan], [-2.0, np.inf]], np.float64)
    np.save(tmp_path / "a.npy", values)
    assert read_depth(tmp_path, "a.npy", SHAPE).tolist() == [[1.5, 0.0], [0.0, 0.0]]
    np.save(tmp_path / "b.npy", np.array([{}], object), allow_pickle=True)
    np.save(tmp_path / "c.npy", np.zeros((2, 2, 3)))
    (tmp_path / "d.npy").write_bytes((tmp_path / "a.npy").read_bytes()[:-8])
    Image.new("RGB", (4, 4)).save(tmp_path / "e.png")
    for name in ("b.npy", "c.npy", "d.npy", "e.png", "missing.npy"):
        with pytest.raises(CaptureError, match=f"{name}: the depth map cannot be read"):
            read_depth(tmp_path, name, SHAPE)


def refused(root, name, why, shape=SHAPE):
    with pytest.raises(CaptureError, match=f"{name}: the depth map cannot be read, perhaps cut short .*{why}"):
        read_depth(root, name, shape)


def write_exr(path, channels):
    import OpenEXR

    OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}, channels).write(str(path))


def test_the_channel_with_depth_of_an_exr_is_read(tmp_path):
    pytest.importorskip("OpenEXR")
    z = np.random.default_rng(0).uniform(1, 5, (6, 8)).astype(np.float32)
    z[0, 0] = np.inf
    known = np.where(np.isfinite(z), z, 0)
    for name, channels in {
        "z": {"Z": z},
        "odd": {"perspective": z},
        "half": {"Y": z.astype(np.float16)},
        "with_colour": {"RGBA": np.ones((6, 8, 4), np.float32), "Z": z},
        "grey": {"RGB": np.repeat(z[..., None], 3, 2)},
    }.items():
        write_exr(tmp_path / f"{name}.exr", channels)
        assert np.allclose(read_depth(tmp_path, f"{name}.exr", SHAPE), known, rtol=1e-3), name


def test_exr_files_without_depth_are_refused(tmp_path):
    pytest.importorskip("OpenEXR")
    rng = np.random.default_rng(0)
    write_exr(tmp_path / "colour.exr", {"RGB": rng.random((6, 8, 3), np.float32)})
    write_exr(tmp_path / "many.exr", {"u": rng.random((6, 8), np.float32), "w": rng.random((6, 8), np.float32)})
    write_exr(tmp_path / "whole.exr", {"Z": rng.random((60, 80), np.float32)})
    whole = (tmp_path / "whole.exr").read_bytes()
    (tmp_path / "cut.exr").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "text.exr").write_bytes(b"no picture")
    at = whole.index(b"dataWindow") + len(b"dataWindow\0box2i\0") + 4
    (tmp_path / "huge.exr").write_bytes(whole[:at] + struct.pack("<4i", 0, 0, 60_000, 60_000) + whole[at + 16 :])
    refused(tmp_path, "colour.exr", "colours")
    refused(tmp_path, "many.exr", "none is depth")
    refused(tmp_path, "huge.exr", "60001x60001")
    for name in ("cut.exr", "text.exr", "missing.exr"):
        refused(tmp_path, name, "")


@pytest.mark.parametrize(("picture", "shape"), [((960, 720), (256, 192)), ((720, 960), (192, 256)), ((480, 641), (192, 256))])
def test_depth_and_confidence_of_record3d_have_the_shape_of_the_picture(picture, shape, tmp_path):
    lzfse = pytest.importorskip("lzfse")
    depth = np.random.default_rng(0).uniform(1, 5, shape).astype(np.float32)
    sure = np.random.default_rng(1).integers(0, 3, shape).astype(np.uint8)
    depth[3, 4] = np.nan
    (tmp_path / "0.depth").write_bytes(lzfse.compress(depth.tobytes()))
    (tmp_path / "0.conf").write_bytes(lzfse.compress(sure.tobytes()))
    assert np.array_equal(read_depth(tmp_path, "0.depth", picture), np.nan_to_num(depth))
    assert np.array_equal(read_depth(tmp_path, "0.conf", picture), sure)


def test_packed_files_that_are_broken_or_promise_too_much_are_refused(tmp_path):
    lzfse = pytest.importorskip("lzfse")
    packed = lzfse.compress(np.random.default_rng(0).random(256 * 192, np.float32).tobytes())
    blocks = {"cut": packed[: len(packed) // 2], "text": b"no depth", "empty": b"", "end": b"bvx$", "odd": lzfse.compress(b"123456789")}
    blocks["bomb"] = b"bvxn" + struct.pack("<II", 2**32 - 1, 4) + b"\x06" * 4 + b"bvx$"
    blocks["ring"] = b"bvx-" + struct.pack("<I", 0) * 3
    for name, data in blocks.items():
        (tmp_path / f"{name}.depth").write_bytes(data)
        refused(tmp_path, f"{name}.depth", "")
    (tmp_path / "0.depth").write_bytes(packed)
    refused(tmp_path, "0.depth", "no shape like the picture's 100x10", (10, 100))


@pytest.mark.parametrize("count", [1, 100, 5000, 200_000])
def test_blocks_tell_how_much_they_hold(count):
    lzfse = pytest.importorskip("lzfse")
    for values in (
        np.zeros(count, np.float32),
        np.linspace(1, 2, count, dtype=np.float32),
        np.random.default_rng(0).random(count, np.float32),
    ):
        assert promised_bytes(lzfse.compress(values.tobytes())) == values.nbytes


def test_a_package_that_is_missing_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(files, "EXTRAS", {".exr": ("no_such_module", "exr")})
    assert files.missing_extra("a.exr") == "exr" and files.missing_extra("a.png") is None
    with pytest.raises(CaptureError, match=r"a.exr: reading it needs: pip install 'e4dgs\[exr\]'"):
        read_depth(tmp_path, "a.exr", SHAPE)
