"""Middlebury's .flo: its exact bytes, what does not fit, files that lie, and writing that is whole or not at all."""

import os
import struct

import numpy as np
import pytest
from e4dgs.vision.flow.flo import write_flo
from flo_files import read_flo


def packed(width: int, height: int, *values: float, magic: float = 202021.25) -> bytes:
    return struct.pack(f"<fii{len(values)}f", magic, width, height, *values)


def test_bytes_are_those_of_the_format(tmp_path):
    flow = np.array([[[1, -2], [0.5, 3e4], [0, 7]]], np.float64)  # one row of three pixels
    write_flo(tmp_path / "a.flo", flow)
    data = (tmp_path / "a.flo").read_bytes()
    assert data == packed(3, 1, 1, -2, 0.5, 3e4, 0, 7) and data[:4] == b"PIEH"
    back = read_flo(tmp_path / "a.flo")
    assert back.dtype == np.float32 and back.shape == (1, 3, 2) and np.array_equal(back, flow)


@pytest.mark.parametrize("dtype", [np.float16, np.float32, ">f4"])
def test_what_is_written_is_read_again(dtype, tmp_path):
    flow = np.random.default_rng(0).normal(0, 20, (7, 5, 2)).astype(dtype)
    write_flo(tmp_path / "a.flo", flow[::-1, :, ::-1])
    assert np.array_equal(read_flo(tmp_path / "a.flo"), flow[::-1, :, ::-1].astype(np.float32))


def test_what_is_not_finite_is_written_as_unknown(tmp_path):
    flow = np.zeros((2, 2, 2), np.float32)
    flow[0, 1, 0], flow[1, 0, 1] = np.nan, np.inf
    write_flo(tmp_path / "a.flo", flow)
    back = read_flo(tmp_path / "a.flo")
    assert (back[0, 1] > 1e9).all() and (back[1, 0] > 1e9).all() and (back[0, 0] == 0).all()
    assert np.isnan(flow[0, 1, 0]), "the caller's array stays as it is"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "0 bytes are too few"),
        (b"PIEH\1\0\0\0\1\0\0", "11 bytes are too few"),
        (packed(1, 1, 0, 0, magic=202021.5), "is not a .flo file"),
        (b"\x89PNG\r\n\x1a\n" + bytes(32), r"begins with b'\\x89PNG'"),
        (struct.pack(">fii2f", 202021.25, 1, 1, 0, 0), "is not a .flo file"),
        (packed(2, 2, *[0.0] * 7), "2x2 take 44 bytes and the file has 40"),
        (packed(2, 2, *[0.0] * 9), "2x2 take 44 bytes and the file has 48"),
        (packed(0, 4), "0x4"),
        (packed(-1, -2, 0, 0, 0, 0), "-1x-2"),
        (packed(2**31 - 1, 2**31 - 1, 0, 0), "2147483647x2147483647"),
        (packed(99_999, 99_999, 0, 0), "79998400020 bytes and the file has 20"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_a_file_that_lies_is_refused_by_name(content, message, tmp_path):
    path = tmp_path / "some flow.flo"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=message) as caught:
        read_flo(path)
    assert str(caught.value).startswith(f"{path}: ")


def test_what_is_no_file_is_refused_without_waiting(tmp_path):
    with pytest.raises(ValueError, match="there is no such file"):
        read_flo(tmp_path / "absent.flo")
    with pytest.raises(ValueError, match="this is not a file"):
        read_flo(tmp_path)
    os.mkfifo(tmp_path / "pipe.flo")
    with pytest.raises(ValueError, match="this is not a file"):
        read_flo(tmp_path / "pipe.flo")


@pytest.mark.parametrize(
    "flow", [np.zeros((4, 4, 3)), np.zeros((4, 4, 2), np.int32), np.zeros((0, 4, 2)), np.zeros((1, 100_000, 2), np.float16)]
)
def test_what_does_not_fit_is_refused_and_nothing_is_left(flow, tmp_path):
    with pytest.raises(ValueError, match=r"a\.flo: "):
        write_flo(tmp_path / "a.flo", flow)
    assert list(tmp_path.iterdir()) == []


def test_a_write_that_fails_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "a.flo"
    write_flo(path, np.ones((2, 2, 2)))
    before = path.read_bytes()

    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("e4dgs.pipeline.files.os.fsync", full)
    with pytest.raises(OSError, match="No space"):
        write_flo(path, np.zeros((2, 2, 2)))
    assert path.read_bytes() == before and [p.name for p in tmp_path.iterdir()] == ["a.flo"]
