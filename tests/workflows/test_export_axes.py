"""Exports of a z-up and of a y-down capture stand upright in the programs that they are for, and a known corner is where it belongs.

The scene is described once, with x to the right, y up and z towards the viewer, and then given the axes of a capture. Programs are asked
where they put its parts, with the turn that each makes of its own accord.
"""

import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import torch
from e4dgs.rasterizer import Camera, Gaussians, rasterize
from e4dgs.scene.camera_paths import look_at
from e4dgs.scene.formats.axes import Turn, unit_vector
from e4dgs.scene.formats.usd.splats import stage_turn, write_usd
from e4dgs.scene.mesh import Mesh, mesh_glb_bytes, mesh_ply_bytes
from e4dgs.scene.model import Model
from e4dgs.scene.motion.static import Static
from e4dgs.scene.primitives import ConvexSet, GaussianSet
from e4dgs.stages.exports.splats import KINDS, SplatFormat, export_splats, turn_of
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))

import export_readers as readers

# Rows: the capture's axes in terms of right, up, towards the viewer.
CAPTURES = {
    "z-up": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),  # Blender, D-NeRF: right, away from the viewer, up
    "y-down": np.array([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]]),  # structure from motion: right, down, front
    "-x-up": np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]),
}
HALF_TURN = {"x": np.diag([1.0, -1, -1]), "z": np.diag([-1.0, -1, 1])}
# What a program does to a file's axes before its own +Y is up: SuperSplat and splat-transform turn PLY and SOG about z. SPZ and glTF say
# where up is. Spark and other programs of three.js turn nothing, so one turns PLY files about x oneself.
PROGRAM = {"ply": HALF_TURN["z"], "compressed-ply": HALF_TURN["z"], "sog": HALF_TURN["z"], "spz": np.eye(3), "gltf": np.eye(3)}
TOLERANCE = {"ply": 1e-6, "compressed-ply": 5e-3, "sog": 1e-3, "spz": 1e-5, "gltf": 1e-6}
FLOOR, HEAD, CORNER = 0, 25, 26  # the floor is the first 25 places


def places() -> np.ndarray:
    """[27, 3] right, up, towards the viewer: a floor, a head high above its middle, and a mark at its right front corner."""
    side = np.linspace(-1, 1, 5)
    floor = np.stack([*np.meshgrid(side, side), np.full((5, 5), -0.5)], -1).reshape(-1, 3)[:, [0, 2, 1]]
    return np.concatenate([floor, [[0.1, 1.2, 0.2], [1.0, -0.4, 1.0]]])


@dataclass
class Frames:
    """As much of a `FrameSet` as exports ask for: cameras around the scene, a little above it, looking a little down."""

    cam_from_world: np.ndarray
    width: int = 48
    height: int = 48
    solved: bool = False  # poses from structure from motion

    def __post_init__(self) -> None:
        count = len(self.cam_from_world)
        self.K = np.tile(np.array([[50.0, 0, 24], [0, 50, 24], [0, 0, 1]]), (count, 1, 1))
        self.time = self.seconds = np.zeros(count)
        self.train, self.val, self.test = np.arange(count), np.arange(0), np.arange(0)

    def held(self, indices: np.ndarray) -> np.ndarray:
        return self.cam_from_world[indices]

    @classmethod
    def around(cls, axes: np.ndarray) -> "Frames":
        eyes = [np.array([3 * np.cos(a), 1.5, 3 * np.sin(a)]) for a in np.arange(6)]
        return cls(np.stack([look_at(axes @ eye, np.zeros(3), axes @ np.array([0.0, 1, 0])) for eye in eyes]))


def model_of(axes: np.ndarray) -> Model:
    """Gaussians of all shapes, directions and colours that depend on where one looks from, at `places`."""
    rng = np.random.default_rng(1)
    gaussians = GaussianSet.from_points((places() @ axes.T).astype(np.float32), rng.uniform(0, 1, (27, 3)), 2, opacity=0.8)
    with torch.no_grad():
        gaussians.log_scales.copy_(torch.from_numpy(rng.uniform(-3.0, -1.5, (27, 3))))
        gaussians.quats.copy_(torch.from_numpy(rng.normal(size=(27, 4))))
        for name, value in gaussians.parameters.items():
            if name.startswith("sh"):
                value.copy_(torch.from_numpy(rng.normal(size=tuple(value.shape)) * 0.3))
    return Model(gaussians, ConvexSet.empty(6, 2), Static(), 2, background=(0.0, 0.0, 0.0))


def exported(tmp_path: Path, kind: SplatFormat, axes: np.ndarray, up: str | None = None) -> Path:
    file = tmp_path / f"scene{KINDS[kind]}"
    export_splats(model_of(axes), Frames.around(axes), file, [0.0], kind, single=True, up=up)
    return file


def read(kind: SplatFormat, file: Path) -> tuple[Gaussians, np.ndarray]:
    """What an independent program reads, and the rotation [3, 3] that the file itself asks for."""
    if kind == "gltf":
        modules = readers.node_modules() or pytest.skip("needs node, and three and gltf-validator from npm: npm install, and E4DGS_NPM")
        told = readers.by_three(modules, file)
        assert readers.errors_of_standard_parts(told) == []
        return readers.gaussians_of_three(told), np.asarray(told["meshes"][0]["matrix"])[:3, :3].T
    if kind == "ply":
        pytest.importorskip("plyfile")
        return readers.by_plyfile(file), np.eye(3)
    transform = readers.splat_transform() or pytest.skip("needs splat-transform: npm install @playcanvas/splat-transform, and E4DGS_NPM")
    return readers.by_splat_transform(transform, file), np.eye(3)


def in_order(found: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """``found`` [N, 3] in the order of ``wanted``: compact formats have orders of their own."""
    return found[np.linalg.norm(found[None] - wanted[:, None], axis=2).argmin(1)]


@pytest.mark.parametrize("capture", CAPTURES)
@pytest.mark.parametrize("kind", KINDS)
def test_splats_stand_upright_in_the_program_they_are_for(tmp_path, kind, capture):
    axes = CAPTURES[capture]
    back, own = read(kind, exported(tmp_path, kind, axes))
    shown = back.means.double().numpy() @ (PROGRAM[kind] @ own).T  # in a program with +Y up
    assert len(shown) == 27
    # Up is certain; which way it faces is not, so the true places may be turned about the vertical.
    wanted = places() @ (PROGRAM[kind] @ Turn(up_of(axes), UP_IN_FILE[kind]).matrix @ axes).T
    np.testing.assert_allclose(in_order(shown, wanted), wanted, atol=TOLERANCE[kind] * 2)
    shown = in_order(shown, wanted)
    np.testing.assert_allclose(shown[:, 1], places()[:, 1], atol=TOLERANCE[kind] * 2)
    assert shown[HEAD, 1] > 1 and shown[:HEAD, 1].max() < -0.45, "the head is above the floor"
    # Seen from above, the corner lies on the same side of head and middle: nothing is mirrored.
    turning = (
        np.cross(shown[CORNER] - shown[12], shown[HEAD] - shown[12])[1],
        np.cross(places()[CORNER] - places()[12], places()[HEAD] - places()[12])[1],
    )
    assert turning[0] == pytest.approx(turning[1], abs=0.05)


UP_IN_FILE = {"ply": "-Y", "compressed-ply": "-Y", "sog": "-Y", "spz": "Y", "gltf": "Y"}


def up_of(axes: np.ndarray) -> str:
    """The capture's axis along which up points."""
    return {(0.0, 0.0, 1.0): "Z", (0.0, -1.0, 0.0): "-Y", (-1.0, 0.0, 0.0): "-X"}[tuple(axes[:, 1])]


@pytest.mark.parametrize("capture", CAPTURES)
@pytest.mark.parametrize(("kind", "least"), [("ply", 70), ("gltf", 70), ("spz", 30), ("compressed-ply", 30), ("sog", 25)])
def test_a_camera_that_turns_with_the_file_sees_the_same(tmp_path, kind, least, capture):
    """Rotations and SH are turned with the positions."""
    axes = CAPTURES[capture]
    frames, model = Frames.around(axes), model_of(axes)
    back, own = read(kind, exported(tmp_path, kind, axes))
    turning = torch.eye(4)
    turning[:3, :3] = torch.from_numpy(np.eye(3) if kind == "gltf" else Turn(up_of(axes), UP_IN_FILE[kind]).matrix)
    assert kind != "gltf" or np.allclose(own, Turn(up_of(axes), "Y").matrix, atol=1e-6), "the node turns, no splat does"
    errors = []
    for pose in torch.from_numpy(frames.cam_from_world).float():
        K = torch.from_numpy(frames.K[0]).float()
        with torch.no_grad():
            truth = rasterize(Camera(K, pose, 48, 48), model.at(0.0)[0], None, torch.zeros(3)).color
        errors.append((rasterize(Camera(K, pose @ turning.T, 48, 48), back, None, torch.zeros(3)).color - truth).square().mean())
    assert -10 * torch.log10(torch.stack(errors).mean()) > least


def lowered(axes: np.ndarray) -> np.ndarray:
    """``axes`` of a world that a camera gave which looked 25 degrees down, and was rolled by 8."""
    return Rotation.from_euler("xz", [25, 8], degrees=True).as_matrix() @ axes


@pytest.mark.parametrize("capture", CAPTURES)
@pytest.mark.parametrize("up", [None, "Z"])
def test_a_world_of_our_own_poses_is_levelled_exactly(tmp_path, capture, up):
    """Positions, rotations and SH: a camera that turns along sees the same."""
    pytest.importorskip("plyfile")
    axes = lowered(CAPTURES[capture])
    frames, model = replace(Frames.around(axes), solved=True), model_of(axes)
    done = export_splats(model, frames, tmp_path / "a.ply", [0.0], single=True, up=up)
    back = readers.by_plyfile(tmp_path / "a.ply")
    height = back.means.double().numpy() @ unit_vector(up or "-Y")
    np.testing.assert_allclose(height, places()[:, 1], atol=1e-3, err_msg="level but for the error of the mean up direction")
    turning = torch.eye(4)
    turning[:3, :3] = torch.from_numpy(done.turn.matrix)
    for pose in torch.from_numpy(frames.cam_from_world[1:]).float():  # the first sees rows of the floor at one depth, in any order
        K = torch.from_numpy(frames.K[0]).float()
        with torch.no_grad():
            truth = rasterize(Camera(K, pose, 48, 48), model.at(0.0)[0], None, torch.zeros(3)).color
        seen = rasterize(Camera(K, pose @ turning.T, 48, 48), back, None, torch.zeros(3)).color
        assert truth.std() > 0.05
        torch.testing.assert_close(seen, truth, atol=1e-3, rtol=0)
    assert turn_of(frames, "capture", "-Y").matrix.tolist() == np.eye(3).tolist(), "and can be left as it is"


def test_meshes_of_our_own_poses_are_level(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    axes = lowered(CAPTURES["y-down"])
    frames = replace(Frames.around(axes), solved=True)
    mesh = Mesh((marked().vertices @ axes.T).astype(np.float32), marked().colors, marked().triangles)
    (tmp_path / "m.glb").write_bytes(mesh_glb_bytes([mesh], [0.0], turn_of(frames, None, "Y")))
    scene = trimesh.load(tmp_path / "m.glb", process=False)
    matrix, geometry = scene.graph[next(iter(scene.graph.nodes_geometry))]
    np.testing.assert_allclose((scene.geometry[geometry].vertices @ matrix[:3, :3].T)[:, 1], marked().vertices[:, 1], atol=1e-3)


@pytest.mark.parametrize("up", ["X", "-X", "Y", "-Y", "Z", "-Z", "capture"])
def test_up_is_where_it_is_asked_for(tmp_path, up):
    axes = CAPTURES["z-up"]
    means = read("ply", exported(tmp_path, "ply", axes, up))[0].means.double().numpy()
    wanted = Turn("Z", "Z" if up == "capture" else up)
    assert np.abs(means @ Turn(wanted.after, "Y").matrix[1] - places()[:, 1]).max() < 1e-6
    np.testing.assert_allclose(means, places() @ axes.T @ wanted.matrix.T, atol=1e-6)


def marked() -> Mesh:
    """A thin triangle for each of `places`, coloured by its number."""
    vertices = (places()[:, None] + 0.01 * np.eye(3)).reshape(-1, 3)
    colors = np.ones((81, 4), np.float32)
    return Mesh(vertices.astype(np.float32), colors, np.arange(81, dtype=np.int32).reshape(-1, 3))


@pytest.mark.parametrize("capture", CAPTURES)
def test_meshes_stand_upright(tmp_path, capture):
    trimesh = pytest.importorskip("trimesh")
    axes = CAPTURES[capture]
    frames = Frames.around(axes)
    mesh = Mesh((marked().vertices @ axes.T).astype(np.float32), marked().colors, marked().triangles)
    (tmp_path / "m.glb").write_bytes(mesh_glb_bytes([mesh, mesh], [0.0, 1.0], turn_of(frames, None, "Y")))
    scene = trimesh.load(tmp_path / "m.glb", process=False)
    names = sorted(scene.graph.nodes_geometry)
    matrix, geometry = scene.graph[names[0]]
    shown = scene.geometry[geometry].vertices @ matrix[:3, :3].T
    np.testing.assert_allclose(shown[:, 1], marked().vertices[:, 1], atol=1e-6)
    (tmp_path / "m.ply").write_bytes(mesh_ply_bytes(mesh, turn_of(frames, None, "Z")))
    read = trimesh.load(tmp_path / "m.ply", process=False).vertices
    np.testing.assert_allclose(read[:, 2], marked().vertices[:, 1], atol=1e-6)
    if (modules := readers.node_modules()) is not None:
        told = readers.by_three(modules, tmp_path / "m.glb")
        first = np.asarray(told["meshes"][0]["matrix"])[:3, :3].T
        shown = told["meshes"][0]["attributes"]["position"] @ first.T
        np.testing.assert_allclose(shown[:, 1], marked().vertices[:, 1], atol=1e-6)
        assert np.linalg.det(first) == pytest.approx(1), "nothing is mirrored"


@pytest.mark.parametrize("capture", CAPTURES)
def test_usd_stands_upright(tmp_path, capture):
    pxr = pytest.importorskip("pxr")
    from pxr import Usd, UsdGeom

    axes = CAPTURES[capture]
    gaussians = model_of(axes).at(0.0)[0]
    write_usd(tmp_path / "s.usdc", lambda t: gaussians, [0.0], 1.0, 24.0, stage_turn(axes @ np.array([0.1, 1.0, 0.1])))
    stage = Usd.Stage.Open(str(tmp_path / "s.usdc"))
    (prim,) = (one for one in stage.Traverse() if one.GetTypeName() == "ParticleField3DGaussianSplat")
    place = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(0)
    shown = np.array([place.Transform(pxr.Gf.Vec3d(*map(float, p))) for p in prim.GetAttribute("positions").Get(0)])
    vertical = "XYZ".index(UsdGeom.GetStageUpAxis(stage))
    np.testing.assert_allclose(shown[:, vertical], places()[:, 1], atol=1e-6)
