"""Scanned point clouds: what Open3D reads, what numpy reads in its place, and that no malformed file gives points."""

import struct
import sys

import numpy as np
import pytest
from e4dgs.pipeline import CaptureError, StageError
from e4dgs.stages.captures.ply_points import read_points
from e4dgs.vision import clouds
from open3d_here import needs_open3d

POINTS = np.array([[1.5, -2, 3], [0, 1e-3, 7], [4, 5, 6.25]])
COLOURS = np.array([[255, 0, 0], [10, 20, 30], [0, 0, 255]], np.uint8)


def rows(*columns) -> str:
    return "".join(" ".join(map(repr, row)) + "\n" for row in np.concatenate(columns, axis=1).tolist())


TEXTS = {
    "a.xyz": rows(POINTS),
    "commented.xyz": "# x y z\n" + rows(POINTS),
    "a.xyzrgb": rows(POINTS, COLOURS / 255),
    "a.pts": "3\n" + "".join(f"{x} {y} {z} -1200 {r} {g} {b}\n" for (x, y, z), (r, g, b) in zip(POINTS.tolist(), COLOURS.tolist())),
    "bare.PTS": rows(POINTS, COLOURS),
}
FIELDS = (
    "VERSION 0.7\nFIELDS x y z rgb\nSIZE 4 4 4 4\nTYPE F F F U\nCOUNT 1 1 1 1\nWIDTH {n}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {n}\n"
)


def pcd(way: str, points=POINTS, colours=COLOURS) -> bytes:
    packed = colours.astype(np.uint32) @ np.array([65536, 256, 1], np.uint32)
    head = (FIELDS.format(n=len(points)) + f"DATA {way}\n").encode()
    if way == "ascii":
        return head + "".join(f"{x} {y} {z} {c}\n" for (x, y, z), c in zip(points.tolist(), packed.tolist())).encode()
    table = np.zeros(len(points), [("xyz", "<f4", 3), ("rgb", "<u4")])
    table["xyz"], table["rgb"] = points, packed
    if way == "binary":
        return head + table.tobytes()
    plain = table["xyz"].T.tobytes() + table["rgb"].tobytes()  # field after field; LZF with literals alone
    parts = b"".join(bytes([len(part) - 1]) + part for part in (plain[k : k + 32] for k in range(0, len(plain), 32)))
    return head + struct.pack("<II", len(parts), len(plain)) + parts


@pytest.mark.parametrize("name", TEXTS)
def test_text_is_read_without_open3d(tmp_path, monkeypatch, name):
    monkeypatch.setitem(sys.modules, "open3d", None)
    (tmp_path / name).write_text(TEXTS[name])
    points, colours = read_points(tmp_path, name)
    np.testing.assert_array_equal(points, POINTS)
    np.testing.assert_array_equal(colours, np.full((3, 3), 128) if "xyz" in name and "rgb" not in name else COLOURS)


@needs_open3d
@pytest.mark.parametrize("name", sorted(TEXTS.keys() - {"bare.PTS"}))  # of which Open3D reads memory that was never written
def test_open3d_reads_the_same_text(tmp_path, name):
    import open3d

    (tmp_path / name).write_text(TEXTS[name])
    cloud = open3d.io.read_point_cloud(str(tmp_path / name), format=name.partition(".")[2].lower())
    np.testing.assert_array_equal(np.asarray(cloud.points), clouds.read_scan(tmp_path / name, 10)[0])
    if cloud.has_colors():
        np.testing.assert_allclose(np.asarray(cloud.colors), clouds.read_scan(tmp_path / name, 10)[1], atol=1e-6)


@needs_open3d
@pytest.mark.parametrize("way", ["ascii", "binary", "binary_compressed"])
def test_pcd(tmp_path, way):
    missing = np.concatenate([POINTS, [[np.nan] * 3]]), np.concatenate([COLOURS, [[1, 2, 3]]])
    (tmp_path / "a.pcd").write_bytes(pcd(way, *missing))
    points, colours = read_points(tmp_path, "a.pcd")
    np.testing.assert_array_equal(points, POINTS if way == "ascii" else POINTS.astype(np.float32))
    np.testing.assert_array_equal(colours, COLOURS)


@needs_open3d
@pytest.mark.parametrize("way", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_our_reader_of_ply_reads_what_open3d_reads(tmp_path, way):
    import open3d

    rng = np.random.default_rng(0)
    table = np.zeros(500, [("xyz", "f8", 3), ("rgb", "u1", 3)])
    table["xyz"], table["rgb"] = rng.normal(size=(500, 3)), rng.integers(0, 256, (500, 3))
    names = [f"property double {n}" for n in "xyz"] + [f"property uchar {n}" for n in ("red", "green", "blue")]
    head = "\n".join(["ply", f"format {way} 1.0", "element vertex 500", *names, "end_header", ""])
    body = (
        "".join(" ".join(map(repr, [*p, *c])) + "\n" for p, c in zip(table["xyz"].tolist(), table["rgb"].tolist())).encode()
        if way == "ascii"
        else table.astype([("xyz", "<f8" if "little" in way else ">f8", 3), ("rgb", "u1", 3)]).tobytes()
    )
    (tmp_path / "a.ply").write_bytes(head.encode() + body)
    points, colours = read_points(tmp_path, "a.ply")
    cloud = open3d.io.read_point_cloud(str(tmp_path / "a.ply"))
    np.testing.assert_array_equal(points, np.asarray(cloud.points))
    np.testing.assert_array_equal(colours, np.rint(255 * np.asarray(cloud.colors)))


def changed(way: str, old: str, new: str) -> bytes:
    return pcd(way).replace(old.encode(), new.encode())


BAD = {
    "word.xyz": (b"1 2 3\n1 a 3\n", "could not convert"),
    "ragged.xyz": (b"1 2 3\n1 2\n", "number of columns changed"),
    "two.xyz": (b"1 2\n3 4\n", "rows of 2 numbers"),
    "four.xyz": (b"1 2 3 4\n", "rows of 4 numbers"),
    "nan.xyz": (b"1 2 nan\n", "vertex 0"),
    "binary.xyz": (bytes(range(256)) * 4, "can't decode"),
    "long.xyz": (b"1 " * 10_000, "first line is too long"),
    "cut.pts": (b"5\n1 2 3 5 10 20 30\n", "5 points are promised"),
    "cut line.pts": (b"2\n1 2 3 5 10 20 30\n1 2 3", "number of columns changed"),
    "billion.pts": (b"999999999999\n1 2 3\n", "999999999999 points are promised"),
    "empty.pcd": (b"", "not a PCD file"),
    "picture.pcd": (b"\x89PNG\r\n" + bytes(2000), "not a PCD file"),
    "header cut.pcd": (pcd("binary")[:90], "not a PCD file"),
    "no data.pcd": (changed("binary", "DATA binary\n", "DATA\n"), "not a PCD file"),
    "unknown.pcd": (changed("binary", "DATA binary", "DATA zipped"), "not a PCD file"),
    "no z.pcd": (changed("binary", "x y z rgb", "x y w rgb"), "no x, y, z"),
    "few sizes.pcd": (changed("binary", "SIZE 4 4 4 4", "SIZE 4 4 4"), "do not agree"),
    "negative.pcd": (changed("binary", "POINTS 3", "POINTS -3"), "not numbers"),
    "many.pcd": (changed("binary", "POINTS 3", "POINTS 999999999"), "too many"),
    "a million.pcd": (changed("binary", "POINTS 3", "POINTS 1000000"), "not all are there"),
    "cut.pcd": (pcd("binary")[:-5], "not all are there"),
    "cut text.pcd": (pcd("ascii").rstrip().rpartition(b"\n")[0], "not all are there"),
    "word.pcd": (changed("ascii", "-2.0", "two"), "could not convert"),
    "cut packed.pcd": (pcd("binary_compressed")[:-5], "not all are there"),
    "packed size.pcd": (changed("binary_compressed", "POINTS 3", "POINTS 4"), "not all are there"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_malformed_file_is_one_message_and_never_reaches_open3d(tmp_path, monkeypatch, name):
    monkeypatch.setitem(sys.modules, "open3d", None)
    data, word = BAD[name]
    (tmp_path / name).write_bytes(data)
    with pytest.raises(CaptureError) as caught:
        read_points(tmp_path, name)
    message = str(caught.value)
    assert message.startswith(f"{name}: ") and word in message and "\n" not in message and len(message) < 500


@needs_open3d
def test_packed_bytes_that_are_wrong_are_an_error_or_points_of_the_file(tmp_path, capfd):
    """Open3D gets these: it must not crash, and what it leaves out must not become points."""
    whole, refused = pcd("binary_compressed", np.tile(POINTS, (40, 1)), np.tile(COLOURS, (40, 1))), 0
    begin, rng = whole.index(b"binary_compressed\n") + 26, np.random.default_rng(0)
    for _ in range(200):
        data = bytearray(whole)
        for place in rng.integers(begin, len(data), 3):
            data[place] = rng.integers(0, 256)
        (tmp_path / "a.pcd").write_bytes(data)
        try:
            points, _ = read_points(tmp_path, "a.pcd")
        except CaptureError as error:
            refused += "Open3D cannot read it" in str(error)
        else:
            assert len(points) <= 120 and (np.abs(points) < 1e12).all()
    assert refused > 5 and not capfd.readouterr().out


@needs_open3d
def test_a_dense_scan_is_thinned_to_means_of_voxels(monkeypatch):
    monkeypatch.setattr(clouds, "ENOUGH", 400)
    rng = np.random.default_rng(0)
    points = np.concatenate([rng.uniform(-1, 1, (5000, 3)) * [1, 1, 0], [[0, 0, 50]]])
    colours = np.stack([points[:, 0] / 2 + 0.5, np.zeros(5001), np.ones(5001)], axis=1)
    few, their = clouds.thinned(points, colours, "a.pcd")
    assert 200 < len(few) <= 400 and (np.abs(few[:, 2]) < 1e-9).sum() == len(few) - 1, "the point far away is one, and costs no others"
    np.testing.assert_allclose(their[:, 0], few[:, 0] / 2 + 0.5, atol=1e-9)
    with pytest.raises(ValueError, match="much farther away"):
        clouds.thinned(np.concatenate([points, [[0, 0, 1e11]]]), np.ones((5002, 3)), "a.pcd")


def test_few_points_are_not_thinned_and_need_no_open3d(monkeypatch):
    monkeypatch.setitem(sys.modules, "open3d", None)
    assert clouds.thinned(POINTS, POINTS, "a.xyz")[0] is POINTS


@pytest.mark.parametrize("way", ["ascii", "binary"])
def test_what_to_install_is_said_where_open3d_cannot_be_loaded(tmp_path, monkeypatch, way):
    monkeypatch.setitem(sys.modules, "open3d", None)
    (tmp_path / "a.pcd").write_bytes(pcd(way))
    with pytest.raises(StageError, match=r"^a.pcd needs the package open3d; install e4dgs again"):
        read_points(tmp_path, "a.pcd")
