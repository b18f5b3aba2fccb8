"""`e4dgs export cameras` and the cameras of `e4dgs export usd` see what the capture's cameras saw."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from e4dgs.pipeline import CaptureError
from e4dgs.scene.formats.axes import Turn
from e4dgs.scene.formats.usd.cameras import PosedCamera, define_cameras
from e4dgs.stages.captures.assembly.far_away import seen_from
from e4dgs.stages.exports.cameras import cameras_json, posed_cameras
from e4dgs.workflows.exports.camera_path import path_of_file
from scipy.spatial.transform import Rotation

WIDTH, HEIGHT = 64, 48


def made_frames(origin=None) -> SimpleNamespace:
    """Seven frames of two cameras; frame 3 has no pose. Lenses differ, and their middle is not that of the picture."""
    rng = np.random.default_rng(0)
    poses = np.tile(np.eye(4), (7, 1, 1))
    poses[:, :3, :3] = Rotation.random(7, rng).as_matrix()
    poses[:, :3, 3] = rng.normal(size=(7, 3))
    poses[3] = np.nan
    K = np.tile(np.array([[70.0, 0, 30.5], [0, 75.0, 25.0], [0, 0, 1]]), (7, 1, 1))
    K[4:, 0, 0] += np.arange(3)
    return SimpleNamespace(
        K=K,
        cam_from_world=poses,
        camera=np.array([0, 0, 0, 0, 1, 1, 1]),
        time=np.array([0.5, 0.0, 1.0, 0.25, 0.0, 0.5, 1.0]),
        names=[f"picture{i}.png" for i in range(7)],
        train=np.array([0, 2, 4, 5]),
        val=np.array([1]),
        test=np.array([6]),
        width=WIDTH,
        height=HEIGHT,
        origin=origin,
    )


@pytest.mark.parametrize("origin", [None, np.array([4e5, 5e6, 100.0])])
@pytest.mark.parametrize("turn", [Turn("Y", "Y"), Turn("-Y", "Z"), Turn.levelling(np.array([0.1, -0.9, 0.3]), "-Y")], ids=str)
def test_render_reads_the_cameras_back(tmp_path, turn, origin):
    frames = made_frames(origin)
    file = tmp_path / "cameras.json"
    file.write_bytes(cameras_json(frames, turn))
    path = path_of_file(file, frames)
    own = [0, 1, 2, 4, 5, 6]
    assert path.notes == () and path.size == (WIDTH, HEIGHT)
    np.testing.assert_allclose(path.cam_from_world, frames.cam_from_world[own], atol=1e-8 if origin is not None else 1e-12)
    np.testing.assert_array_equal(path.K, frames.K[own])
    np.testing.assert_array_equal(path.time, frames.time[own])


def test_poses_lie_beside_what_was_turned_alike(tmp_path):
    frames, turn, point = made_frames(), Turn("-Y", "Z"), np.array([0.3, 0.2, 2.0])
    for row in json.loads(cameras_json(frames, turn))["frames"]:
        i = frames.names.index(row["file_path"])
        seen = np.linalg.inv(row["transform_matrix"]) @ [*(turn.matrix @ point), 1]  # x right, y up, z back
        np.testing.assert_allclose(seen[:3] * [1, -1, -1], (frames.cam_from_world[i] @ [*point, 1])[:3], atol=1e-12)


def test_a_wrong_transform_names_its_field(tmp_path):
    file = tmp_path / "cameras.json"
    data = json.loads(cameras_json(made_frames(), Turn("Y", "Y")))
    file.write_text(json.dumps(data | {"file_from_capture": (2 * np.eye(4)).tolist()}))
    with pytest.raises(CaptureError, match="file_from_capture"):
        path_of_file(file, made_frames())


def test_usd_cameras_project_as_the_lenses_do():
    pxr = pytest.importorskip("pxr")
    from pxr import Usd, UsdGeom

    stage, frames = Usd.Stage.CreateInMemory(), made_frames()
    UsdGeom.Xform.Define(stage, "/World").AddRotateXOp().Set(90.0)
    stage.SetEndTimeCode(2.0)
    cameras = posed_cameras(frames, 0.1)
    assert [(camera.name, len(camera.time)) for camera in cameras] == [("cam00", 3), ("cam01", 3)]
    define_cameras(stage, "/World/Cameras", cameras, 4.0)
    about = np.array(UsdGeom.XformCache().GetLocalToWorldTransform(stage.GetPrimAtPath("/World"))).T
    for camera in cameras:
        prim = UsdGeom.Camera(stage.GetPrimAtPath(f"/World/Cameras/{camera.name}"))
        for t, pose, K in zip(camera.time, camera.cam_from_world, camera.K, strict=True):
            point = np.linalg.inv(pose) @ [0.4, -0.3, 2.0, 1]
            frustum = prim.GetCamera(4.0 * t).frustum
            x, y, _ = (frustum.ComputeViewMatrix() * frustum.ComputeProjectionMatrix()).Transform(pxr.Gf.Vec3d(*(about @ point)[:3]))
            place = (x + 1) / 2 * WIDTH, (1 - y) / 2 * HEIGHT
            np.testing.assert_allclose(place, (K @ [0.4, -0.3, 2.0])[:2] / 2.0, atol=1e-4)
            assert frustum.nearFar.min == pytest.approx(0.1)
    assert stage.GetEndTimeCode() == 2.0, "the stage shows the times that were asked for"


def test_two_poses_of_one_time_leave_the_others_at_theirs():
    time = np.array([0.0, 0.5, 0.5, 1.0])
    camera = PosedCamera("cam00", time, np.tile(np.eye(4), (4, 1, 1)), np.tile(np.eye(3), (4, 1, 1)), WIDTH, HEIGHT, 0.1)
    assert camera.codes(20.0).tolist() == [0.0, 10.0, 10.0, 20.0]


def test_a_walk_around_what_stands_still_is_a_path_of_its_own():
    pytest.importorskip("pxr")
    from pxr import Usd, UsdGeom

    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, 0, 3] = [0, -1, -2]
    camera = PosedCamera("cam00", np.full(3, 0.5), poses, np.tile(np.diag([50.0, 50, 1]), (3, 1, 1)), WIDTH, HEIGHT, 0.1)
    stage = Usd.Stage.CreateInMemory()
    define_cameras(stage, "/World/Cameras", [camera], 0.0)
    prim = UsdGeom.Camera(stage.GetPrimAtPath("/World/Cameras/cam00"))
    assert stage.GetEndTimeCode() == 2.0
    assert [prim.ComputeLocalToWorldTransform(code).ExtractTranslation()[0] for code in (0, 1, 2)] == [0, 1, 2]
    assert not prim.GetFocalLengthAttr().GetTimeSamples(), "what does not change has one value"


def test_origin_is_what_was_moved():
    """The same camera, seen from the capture's files and from here."""
    frames = made_frames(np.array([10.0, 20.0, 30.0]))
    data = json.loads(cameras_json(frames, Turn("Y", "Y")))
    there = np.array(data["file_from_capture"])
    point = np.array([11.0, 19.0, 33.0, 1.0])
    np.testing.assert_allclose(there @ point, [1, -1, 3, 1])
    in_files = frames.cam_from_world[0] @ there
    np.testing.assert_allclose(seen_from(frames.origin, in_files[None])[0], frames.cam_from_world[0], atol=1e-12)
