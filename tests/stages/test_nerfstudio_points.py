"""`ply_file_path`: the points that training begins at, in the world of the poses, and what is said of files that cannot be."""

import json
import shutil

import numpy as np
import pytest
from e4dgs.pipeline import CaptureError
from e4dgs.stages.captures import recognise
from e4dgs.stages.captures.ply_points import read_points
from factory import surface_points
from run_stage import run_frames

KINDS = ("ascii", "binary_little_endian", "binary_big_endian")
COLMAP_TO_NERFSTUDIO = [[0.0, 1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0]]


def ply(points, colours, kind="ascii", types=("float", "uchar"), extra=""):
    """A point cloud as bytes; `extra` is a further vertex property of type float, zero everywhere."""
    code = {"float": "f4", "double": "f8", "uchar": "u1"}
    fields = [(n, types[0]) for n in "xyz"] + ([(extra, "float")] if extra else []) + [(n, types[1]) for n in ("red", "green", "blue")]
    head = ["ply", f"format {kind} 1.0", "comment made by a test", f"element vertex {len(points)}"]
    head += [f"property {t} {n}" for n, t in fields] + ["element face 0", "property list uchar int vertex_indices", "end_header", ""]
    order = ">" if kind == "binary_big_endian" else "<"
    table = np.zeros(len(points), [(n, order + code[t]) for n, t in fields])
    for i, n in enumerate("xyz"):
        table[n] = points[:, i]
    for i, n in enumerate(("red", "green", "blue")):
        table[n] = colours[:, i]
    body = "\n".join(" ".join(map(repr, row.tolist())) for row in table).replace("(", "").replace(")", "").replace(",", "").encode()
    return "\n".join(head).encode() + (body if kind == "ascii" else table.tobytes())


@pytest.fixture
def capture(nerfstudio_capture, tmp_path):
    """A copy of the capture, and `write(bytes, **head)` that puts a cloud beside it."""
    root = shutil.copytree(nerfstudio_capture.root, tmp_path / "capture")

    def write(data, name="sparse_pc.ply", **head):
        if data is not None:
            (root / "sparse_pc.ply").write_bytes(data)
        document = json.loads((nerfstudio_capture.root / "transforms.json").read_text())
        (root / "transforms.json").write_text(json.dumps({**document, "ply_file_path": name, **head}))
        return root

    return write


@pytest.fixture(scope="module")
def cloud(nerfstudio_capture):
    return surface_points(nerfstudio_capture.synthetic, 200)


@pytest.mark.parametrize("kind", KINDS)
def test_points_are_those_of_the_file(capture, cloud, kind, tmp_path):
    root = capture(ply(*cloud, kind, ("double", "uchar"), extra="confidence"), "./sparse_pc.ply")
    found = recognise(root)
    assert found.facts["points"] and "sparse_pc.ply" in found.files
    np.testing.assert_array_equal(found.points, cloud[0])
    np.testing.assert_array_equal(found.point_colors, cloud[1])
    written = run_frames(root, tmp_path).artifact
    np.testing.assert_array_equal(written.read("points"), cloud[0])
    np.testing.assert_array_equal(written.read("point_colors"), cloud[1])


def test_colours_may_be_fractions_or_absent(tmp_path, cloud):
    (tmp_path / "a.ply").write_bytes(ply(cloud[0], cloud[1] / 255, "binary_little_endian", ("float", "float")))
    points, colours = read_points(tmp_path, "a.ply")
    np.testing.assert_allclose(points, cloud[0], atol=1e-6)
    np.testing.assert_array_equal(colours, cloud[1])
    (tmp_path / "b.ply").write_text("ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\n"
                                    "end_header\n0 1 2\n3 4 5\n")  # fmt: skip
    points, colours = read_points(tmp_path, "b.ply")
    assert points.tolist() == [[0, 1, 2], [3, 4, 5]] and (colours == 128).all()


COLOURS = {  # (names, type, values of (0, 64, 255) of 255)
    "splat": ("f_dc_0 f_dc_1 f_dc_2", "float", [-1.7724538509, -0.8825592704, 1.7724538509]),
    "diffuse": ("diffuse_red diffuse_green diffuse_blue", "uchar", [0, 64, 255]),
    "16 bits": ("red green blue", "ushort", [0, 16448, 65535]),
    "16 bits of which 8 are used": ("red green blue", "ushort", [0, 64, 255]),
    "short names": ("R G B", "uchar", [0, 64, 255]),
    "floats to 255": ("red green blue", "float", [0, 64, 255]),
    "doubles to 1": ("red green blue", "double", [0, 64 / 255, 1]),
}


@pytest.mark.parametrize("order", ["ascii", "binary_little_endian"])
@pytest.mark.parametrize("case", COLOURS)
def test_colours_of_other_names_and_types(capture, case, order):
    names, kind, values = COLOURS[case]
    code = {"float": "<f4", "double": "<f8", "uchar": "u1", "ushort": "<u2"}[kind]
    rows = np.zeros(2, [("x", "<f4", 3), ("c", code, 3)])
    rows["x"], rows["c"] = [[0, 1, 2], [3, 4, 5]], [values, values[::-1]]
    fields = [f"property float {axis}" for axis in "xyz"] + [f"property {kind} {name}" for name in names.split()]
    head = "\n".join(["ply", f"format {order} 1.0", "element vertex 2", *fields, "end_header\n"])
    text = "".join(" ".join(map(repr, [*x, *c])) + "\n" for x, c in zip(rows["x"].tolist(), rows["c"].tolist(), strict=True))
    root = capture(None, "points.ply")
    (root / "points.ply").write_bytes(head.encode() + (text.encode() if order == "ascii" else rows.tobytes()))
    found = recognise(root)
    assert found.points.tolist() == [[0, 1, 2], [3, 4, 5]]
    assert found.point_colors.tolist() == [[0, 64, 255], [255, 64, 0]] and not any("grey" in note for note in found.notes)


def test_a_cloud_without_colours_is_said(capture, cloud):
    root = capture(None, "points.ply")
    rows = "".join(f"{x} {y} {z}\n" for x, y, z in cloud[0].tolist())
    head = f"ply\nformat ascii 1.0\nelement vertex {len(cloud[0])}\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
    (root / "points.ply").write_text(head + rows)
    assert [note for note in recognise(root).notes if "grey" in note] == [
        "points.ply has no colours under names that are known (red, green, blue): its points are grey"
    ]


def test_points_may_be_a_scan(capture, cloud):
    root = capture(None, "scan.xyz")
    (root / "scan.xyz").write_text("".join(f"{x} {y} {z}\n" for x, y, z in cloud[0].tolist()))
    found = recognise(root)
    np.testing.assert_array_equal(found.points, cloud[0])
    assert (found.point_colors == 128).all() and "scan.xyz" in found.files and not any("scan.xyz" in note for note in found.notes)


def test_applied_transform_is_in_the_points_already(capture, cloud):
    """As nerfstudio writes both since 2023: points and poses share a world, and the field only tells how that came about."""
    found = recognise(capture(ply(*cloud, types=("double", "uchar")), applied_transform=COLMAP_TO_NERFSTUDIO))
    np.testing.assert_array_equal(found.points, cloud[0])


@pytest.mark.parametrize(("data", "name", "word"), [(None, "gone.ply", "no file 'gone.ply'"), (b"", "sparse_pc.ply", None)])
def test_without_points_the_capture_is_read_and_it_is_said(capture, data, name, word):
    found = recognise(capture(ply(np.zeros((0, 3)), np.zeros((0, 3))) if data == b"" else None, name))
    assert not found.facts["points"] and found.points is None
    assert word is None or any(word in note for note in found.notes)


HEAD = b"ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
BAD = {
    "empty": (b"", "not a PLY file"),
    "a picture": (b"\x89PNG\r\n", "not a PLY file"),
    "header cut": (HEAD[:60], "cut short within its header"),
    "header without end": (b"ply\n" + b"comment x\n" * 100_000, "cut short within its header"),
    "body cut": (HEAD + b"0 0 0\n1 1\n", "2 vertices are promised"),
    "words": (HEAD + b"0 0 0\n1 a 1\n", "2 vertices are promised"),
    "NaN": (HEAD + b"0 0 0\n1 nan 1\n", "vertex 1: x, y, z"),
    "Inf": (HEAD + b"0 0 0\n1 inf 1\n", "vertex 1: x, y, z"),
    "huge": (HEAD + b"0 0 0\n1 1e200 1\n", "vertex 1: x, y, z"),
    "binary cut": (HEAD.replace(b"ascii", b"binary_little_endian") + bytes(20), "2 vertices are promised"),
    "a billion": (HEAD.replace(b"vertex 2", b"vertex 999999999999") + b"0 0 0", "999999999999 vertices are promised"),
    "a binary billion": (HEAD.replace(b"ascii", b"binary_big_endian").replace(b"vertex 2", b"vertex 999999999999"), "are promised"),
    "endless count": (HEAD.replace(b"vertex 2", b"vertex " + b"9" * 5000), "no count"),
    "negative count": (HEAD.replace(b"vertex 2", b"vertex -2"), "no count"),
    "no format": (HEAD.replace(b"format ascii 1.0\n", b""), "format ''"),
    "unknown type": (HEAD.replace(b"float y", b"half y"), "'half y'"),
    "a list": (HEAD.replace(b"float y", b"list uchar int y"), "'list uchar int y'"),
    "the same twice": (HEAD.replace(b"float y", b"float x"), "'float x'"),
    "no z": (HEAD.replace(b"float z", b"float w"), "no z"),
    "faces first": (HEAD.replace(b"element vertex", b"element face"), "first element"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_files_are_one_message(capture, case):
    data, word = BAD[case]
    with pytest.raises(CaptureError) as caught:
        recognise(capture(data))
    message = str(caught.value)
    assert message.startswith("sparse_pc.ply: ") and word in message and "\n" not in message and len(message) < 500


def test_bad_fields_are_one_message(capture, cloud):
    for name, word in (
        ("../secret.ply", "leaves the capture"),
        (7, "expected a non-empty string"),
        ("\ud800", "cannot be followed"),
        ("a\0", "leaves the capture"),
    ):
        with pytest.raises(CaptureError, match=f"transforms.json: ply_file_path: .*{word}"):
            recognise(capture(None, name))
