"""`e4dgs export mesh` writes what other programs read as a coloured mesh: .ply a time, or one .glb that plays through several."""

import io
import json
import struct
import sys

import e4dgs
import numpy as np
import pytest
import trimesh
from e4dgs.scene.mesh import Mesh, mesh_glb_bytes, mesh_ply_bytes
from e4dgs.stages.exports.mesh import look
from e4dgs.workflows.cli import main
from e4dgs.workflows.exports.mesh import MARGIN
from open3d_here import needs_open3d
from scipy.spatial import ConvexHull

QUICK = ["--set", "coarse.iterations=150", "--set", "hulls.budget=20", "--set", "fine.iterations=10", "--device", "cpu"]


@pytest.fixture(scope="module")
def finished(dnerf_capture, tmp_path_factory):
    workspace = tmp_path_factory.mktemp("mesh") / "workspace"
    assert main(["run", "all", str(dnerf_capture.root), "--workspace", str(workspace), *QUICK]) == 0
    return dnerf_capture, workspace


def export(finished, *options: object) -> int:
    capture, workspace = finished
    return main(["export", "mesh", str(capture.root), "--workspace", str(workspace), *QUICK, *map(str, options)])


@needs_open3d
def test_a_scene_becomes_a_mesh_about_where_it_is(finished, tmp_path, capsys):
    out = tmp_path / "new" / "scene.ply"
    assert export(finished, "--time", 0.25, "--out", out) == 0
    assert "triangles; voxels of" in " ".join(capsys.readouterr().out.split())
    assert [f.name for f in out.parent.iterdir()] == ["scene.ply"], "nothing half-written is left"
    read = trimesh.load(out)
    # The slab is 3 x 3, its top at 0; what stands on it reaches to some 1.3. The model is a rough one.
    assert 2.2 < np.ptp(np.percentile(read.vertices[:, 0], (2, 98))) < 3.8
    assert 0.4 < np.percentile(read.vertices[:, 2], 99.5) < 1.6
    up = read.vertices[np.abs(read.vertices[:, :2]).max(1) < 1.2]
    assert abs(np.median(up[:, 2])) < 0.15, "most of it is the slab"
    assert read.visual.vertex_colors[:, :3].std(0).min() > 10


@needs_open3d
def test_several_times_are_numbered_files_or_one_that_plays(finished, tmp_path):
    assert export(finished, "--times", 2, "--voxel", 0.15, "--out", tmp_path / "folder") == 0
    files = sorted((tmp_path / "folder").glob("*.ply"))
    assert [f.name for f in files] == ["frame0001.ply", "frame0002.ply"]
    assert files[0].read_bytes() != files[1].read_bytes(), "something moves"
    assert export(finished, "--times", 2, "--voxel", 0.15, "--out", tmp_path / "scene.glb") == 0
    read = trimesh.load(tmp_path / "scene.glb", process=False)
    sizes = [len(trimesh.load(f, process=False).vertices) for f in files]
    assert [len(shape.vertices) for shape in read.geometry.values()] == sizes


@needs_open3d
@pytest.mark.parametrize("out", ["a.glb", "folder"])
def test_a_time_without_a_surface_is_said_and_the_others_are_there(finished, tmp_path, monkeypatch, capsys, out):
    def looked(model, frames, i, t):
        seen = look(model, frames, i, t)
        return seen if t else seen._replace(depth=np.zeros_like(seen.depth))

    monkeypatch.setattr("e4dgs.stages.exports.mesh.look", looked)
    assert export(finished, "--times", 2, "--voxel", 0.15, "--out", tmp_path / out) == 0
    assert "note: no surface at 1 of 2 times, first at time 0; there the mesh is empty" in " ".join(capsys.readouterr().out.split())
    if out == "folder":
        first, last = sorted((tmp_path / out).glob("*.ply"))
        assert b"element face 0\n" in first.read_bytes() and len(trimesh.load(last).faces) > 0


@pytest.mark.parametrize("out", ["a.glb", "a.ply", "folder"])
def test_hulls_of_nothing_are_an_error(finished, tmp_path, monkeypatch, capsys, out):
    nothing = Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 4), np.float32), np.zeros((0, 3), np.int32))
    monkeypatch.setattr("e4dgs.stages.exports.mesh.hulls", lambda model, t, advance: nothing)
    assert export(finished, "--convexes", "--time", 0.25, "--out", tmp_path / out) != 0
    said = " ".join(capsys.readouterr().err.split())
    assert "nothing is visible at time 0.25" in said and "--time" in said and not list(tmp_path.iterdir())


def test_a_glb_that_grows_too_large_is_refused_before_its_end(finished, tmp_path, monkeypatch, capsys):
    asked = []

    def counting(model, t, advance):
        asked.append(t)
        return tetrahedron(t)

    assert tetrahedron(0).bytes_in_glb == 4 * (3 * 4 + 4 * 2) + 4 * 3 * 4
    monkeypatch.setattr("e4dgs.stages.exports.mesh.hulls", counting)
    monkeypatch.setattr("e4dgs.scene.formats.glb.MOST_BYTES", 5 * MARGIN + 500)
    assert export(finished, "--convexes", "--times", 5, "--out", tmp_path / "a.glb") == 1
    said = " ".join(capsys.readouterr().err.split())
    assert "a.glb: up to time 0.75" in said and ".ply" in said and "--voxel" in said and "--times" in said and not list(tmp_path.iterdir())
    assert asked == [0.0, 0.25, 0.5, 0.75], "as soon as it is known"
    with pytest.raises(ValueError, match=r"a \.glb file holds 0\.00 GB at most"):
        mesh_glb_bytes([tetrahedron(0)] * 20, range(20))


def test_what_a_glb_has_beside_its_meshes_takes_no_more_than_is_kept_for_it():
    meshes = [tetrahedron(k) for k in range(100)]
    assert len(mesh_glb_bytes(meshes, [k / 3 for k in range(100)])) - sum(one.bytes_in_glb for one in meshes) < 100 * MARGIN


def test_what_brings_open3d_is_named_where_it_is_not_there(finished, tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "open3d", None)
    assert export(finished, "--time", 0.25, "--out", tmp_path / "scene.ply") == 1
    assert "needs the package open3d; install e4dgs again" in " ".join(capsys.readouterr().err.split()) and not list(tmp_path.iterdir())


def test_a_library_of_the_system_that_open3d_lacks_is_named(finished, tmp_path, monkeypatch, capsys):
    broken = tmp_path / "broken" / "open3d"
    broken.mkdir(parents=True)
    (broken / "__init__.py").write_text("raise ImportError('libusb-1.0.so.0: cannot open shared object file')")
    for name in [name for name in sys.modules if name.partition(".")[0] == "open3d"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.syspath_prepend(broken.parent)
    assert export(finished, "--time", 0.25, "--out", tmp_path / "scene.ply") == 1
    said = capsys.readouterr().err
    assert "libusb-1.0.so.0" in said and "apt-get install" in said and "pip" not in said


def test_convexes_are_an_animated_mesh_of_their_hulls(finished, tmp_path, capsys):
    capture, workspace = finished
    assert export(finished, "--convexes", "--out", tmp_path / "hulls.glb") == 0
    content, binary = parsed((tmp_path / "hulls.glb").read_bytes())
    times = len({view.time for view in capture.views})
    assert len(content["nodes"]) - 1 == len(content["animations"][0]["channels"]) == times
    assert content["nodes"][-1]["children"] == list(range(times)) and content["scenes"][0]["nodes"] == [times], "the parent of all turns"
    np.testing.assert_allclose(content["nodes"][-1]["rotation"], [-(0.5**0.5), 0, 0, 0.5**0.5], err_msg="z of D-NeRF becomes y")
    assert export(finished, "--convexes", "--up", "capture", "--time", 0, "--out", tmp_path / "as_it_is.glb") == 0
    assert "rotation" not in parsed((tmp_path / "as_it_is.glb").read_bytes())[0]["nodes"][-1]
    model = e4dgs.load(capture.root, workspace=workspace)
    for k in (0, times // 2):
        _, convexes = model.at(k / (times - 1))
        primitive = content["meshes"][content["nodes"][k]["mesh"]]["primitives"][0]
        shown = rows(content, binary, primitive["attributes"]["POSITION"])
        seen = convexes.points[convexes.opacities >= 1 / 255].detach().numpy()
        np.testing.assert_allclose([shown.min(0), shown.max(0)], [seen.min((0, 1)), seen.max((0, 1))], atol=1e-6)
        triangles = shown[rows(content, binary, primitive["indices"]).reshape(-1, 3)].astype(float)
        volume = np.linalg.det(triangles - seen.mean((0, 1))).sum() / 6
        assert volume == pytest.approx(sum(ConvexHull(one).volume for one in seen), rel=1e-3)
    assert export(finished, "--convexes", "--time", 1, "--out", tmp_path / "hulls.ply") == 0
    assert f"{len(model.convexes)} convexes" in capsys.readouterr().out


def test_an_export_of_fewer_times_leaves_none_of_the_earlier_one(finished, tmp_path):
    (tmp_path / "frame0009.ply.txt").write_text("mine")
    (tmp_path / "frame0009.ply").mkdir()
    for times in (4, 2):
        assert export(finished, "--convexes", "--times", times, "--out", tmp_path) == 0
        made = {f.name for f in tmp_path.iterdir()}
        assert made == {f"frame000{k + 1}.ply" for k in range(times)} | {"frame0009.ply.txt", "frame0009.ply", "sequence.json"}


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--convexes", "--voxel", 0.1), "have no voxels"),
        (("--voxel", 0), "positive size"),
        (("--time", 0.5, "--times", 2), "give one of them"),
        (("--times", 2, "--out", "a.ply"), "a .ply file holds one time, and here are 2"),
        (("--out", "a.obj"), ".glb or .ply"),
    ],
)
def test_a_bad_option_is_one_message(finished, capsys, monkeypatch, tmp_path, options, words):
    monkeypatch.chdir(tmp_path)
    assert export(finished, *options) == 2
    assert words in " ".join(capsys.readouterr().err.split()) and not list(tmp_path.iterdir())


def tetrahedron(shift: float, opacity: float = 1.0) -> Mesh:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], np.float32) + np.float32(shift)
    colors = np.array([[1, 0, 0, opacity], [0, 1, 0, opacity], [0, 0, 1, opacity], [0.5, 0.5, 0.5, opacity]], np.float32)
    return Mesh(vertices, colors, np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]], np.int32))


def test_another_reader_finds_the_same_in_ply():
    read = trimesh.load(io.BytesIO(mesh_ply_bytes(tetrahedron(2.0, 0.4))), file_type="ply", process=False)
    np.testing.assert_array_equal(read.vertices, tetrahedron(2.0).vertices)
    np.testing.assert_array_equal(read.faces, tetrahedron(2.0).triangles)
    np.testing.assert_array_equal(read.visual.vertex_colors[3], [128, 128, 128, 102])
    assert read.is_watertight and read.volume > 0


def parsed(file: bytes) -> tuple[dict, bytes]:
    (length,) = struct.unpack_from("<I", file, 12)
    return json.loads(file[20 : 20 + length]), file[20 + length + 8 :]


def rows(content: dict, binary: bytes, k: int) -> np.ndarray:
    accessor = content["accessors"][k]
    kind = {5126: "<f4", 5123: "<u2", 5125: "<u4"}[accessor["componentType"]]
    width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor["type"]]
    return np.frombuffer(binary, kind, accessor["count"] * width, content["bufferViews"][accessor["bufferView"]]["byteOffset"]).reshape(
        -1, width
    )


def test_glb_shows_one_mesh_at_a_time():
    content, binary = parsed(mesh_glb_bytes([tetrahedron(0), tetrahedron(1), tetrahedron(2, 0.5)], [1.0, 1.5, 2.0]))
    (animation,) = content["animations"]
    shown = {}
    for seconds in (0.0, 0.49, 0.5, 0.99, 1.0, 1.5):
        shown[seconds] = []
        for channel in animation["channels"]:
            sampler = animation["samplers"][channel["sampler"]]
            assert (channel["target"]["path"], sampler["interpolation"]) == ("scale", "STEP")
            times, scales = rows(content, binary, sampler["input"])[:, 0], rows(content, binary, sampler["output"])
            assert (np.diff(times) > 0).all()
            scale = scales[max(0, np.searchsorted(times, seconds + 1e-6) - 1)]  # STEP: the last key at or before
            if scale.all():
                shown[seconds].append(channel["target"]["node"])
    assert shown == {0.0: [0], 0.49: [0], 0.5: [1], 0.99: [1], 1.0: [2], 1.5: [2]}
    assert max(rows(content, binary, s["input"]).max() for s in animation["samplers"]) == 1.5, "the last is seen as long as the others"
    assert [node["scale"] for node in content["nodes"][:-1]] == [[1, 1, 1], [0, 0, 0], [0, 0, 0]], "without animation, the first"
    materials = [content["materials"][shape["primitives"][0]["material"]] for shape in content["meshes"]]
    assert ["alphaMode" in material for material in materials] == [False, False, True]


def test_glb_holds_linear_colours_and_readers_find_the_shape():
    file = mesh_glb_bytes([tetrahedron(3.0)])
    content, binary = parsed(file)
    assert "animations" not in content
    attributes = content["meshes"][0]["primitives"][0]["attributes"]
    grey = rows(content, binary, attributes["COLOR_0"])[3] / 65535
    np.testing.assert_allclose(grey, [0.2140, 0.2140, 0.2140, 1], atol=1e-4)  # 0.5 of sRGB
    (read,) = trimesh.load(io.BytesIO(file), file_type="glb", process=False).geometry.values()
    np.testing.assert_array_equal(read.vertices, tetrahedron(3.0).vertices)
    assert read.is_watertight and read.volume > 0
