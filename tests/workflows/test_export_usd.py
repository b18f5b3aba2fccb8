"""`e4dgs export usd` writes one file that OpenUSD reads: the model's Gaussians as time samples, upright, with a rate."""

import sys

import e4dgs
import numpy as np
import pytest
import torch
from e4dgs.rasterizer import Camera, Convexes, Gaussians, rasterize
from e4dgs.scene.convex_gaussians import GaussianFit
from e4dgs.scene.formats.axes import Turn, nearest_axis
from e4dgs.scene.formats.ply import LEAST_ALPHA
from e4dgs.scene.formats.usd.splats import stage_turn, write_usd
from e4dgs.scene.rotation import quats_to_matrices
from e4dgs.workflows.cli import main
from scipy.spatial.transform import Rotation
from small_disk import small_disk

pxr = pytest.importorskip("pxr")
from pxr import Gf, Usd, UsdGeom, UsdValidation, UsdVol  # noqa: E402

pytestmark = pytest.mark.usefixtures("short_fit")
QUICK = ["--set", "coarse.iterations=40", "--set", "hulls.budget=20", "--set", "fine.iterations=10", "--device", "cpu"]


@pytest.fixture(scope="module")
def finished(dnerf_capture, tmp_path_factory):
    workspace = tmp_path_factory.mktemp("usd") / "workspace"
    assert main(["run", "all", str(dnerf_capture.root), "--workspace", str(workspace), *QUICK]) == 0
    return dnerf_capture, workspace


def export(finished, *options: object) -> int:
    capture, workspace = finished
    return main(["export", "usd", str(capture.root), "--workspace", str(workspace), *QUICK, *map(str, options)])


def splats_of(stage: Usd.Stage) -> UsdVol.ParticleField3DGaussianSplat:
    """The one prim of this type."""
    (found,) = (prim for prim in stage.Traverse() if prim.IsA(UsdVol.ParticleField3DGaussianSplat))
    return UsdVol.ParticleField3DGaussianSplat(found)


def gaussians_of(splats: UsdVol.ParticleField3DGaussianSplat, code: float) -> Gaussians:
    """At a time code, by the schema's definitions alone."""
    at = lambda attribute: np.array(attribute.Get(code))  # noqa: E731
    means = at(splats.GetPositionsAttr())
    quats = np.array([[q.real, *q.imaginary] for q in splats.GetOrientationsAttr().Get(code)])
    degree = splats.GetRadianceSphericalHarmonicsDegreeAttr().Get()
    sh = at(splats.GetRadianceSphericalHarmonicsCoefficientsAttr()).reshape(len(means), (degree + 1) ** 2, 3)
    tensors = (torch.tensor(a).float() for a in (means, quats, at(splats.GetScalesAttr()), at(splats.GetOpacitiesAttr())))
    return Gaussians(*tensors, sh=torch.tensor(sh))


def test_time_samples_are_the_model_at_these_times(finished, tmp_path, capsys):
    capture, workspace = finished
    out = tmp_path / "new" / "scene.usdc"
    assert export(finished, "--times", 3, "--out", out) == 0
    assert [f.name for f in out.parent.iterdir()] == ["scene.usdc"], "nothing half-written is left"
    assert "convexes became Gaussians" in " ".join(capsys.readouterr().out.split())
    stage = Usd.Stage.Open(str(out))
    last = len({view.time for view in capture.views}) - 1
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (0, last)
    assert stage.GetFramesPerSecond() == stage.GetTimeCodesPerSecond() > 0
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1 and UsdGeom.GetStageUpAxis(stage) == "Z", "D-NeRF stands upright on z"
    splats = splats_of(stage)
    for attribute in (
        splats.GetPositionsAttr(),
        splats.GetOrientationsAttr(),
        splats.GetScalesAttr(),
        splats.GetOpacitiesAttr(),
        splats.GetRadianceSphericalHarmonicsCoefficientsAttr(),
        splats.GetExtentAttr(),
    ):
        assert attribute.GetTimeSamples() == [0, last / 2, last], attribute.GetName()
    model = e4dgs.load(capture.root, workspace=workspace)
    for t in (0.0, 0.5, 1.0):
        back = gaussians_of(splats, t * last)
        gaussians, convexes = model.at(t)
        seen = (gaussians.opacities >= LEAST_ALPHA).numpy()
        assert len(back.means) == seen.sum() + (convexes.opacities >= LEAST_ALPHA).sum()
        np.testing.assert_allclose(back.means[: seen.sum()], gaussians.means.detach()[seen], atol=1e-4)
    assert np.ptp([gaussians_of(splats, t * last).means.numpy() for t in (0, 1)], axis=0).max() > 1e-3, "something moves"


def test_one_time_is_one_sample_at_its_frame(finished, tmp_path, capsys):
    capture, _ = finished
    last = len({view.time for view in capture.views}) - 1
    assert export(finished, "--time", 0.25, "--antialiased", "--out", tmp_path / "scene.usdc") == 0
    stage = Usd.Stage.Open(str(tmp_path / "scene.usdc"))
    assert splats_of(stage).GetPositionsAttr().GetTimeSamples() == [0.25 * last] == [stage.GetStartTimeCode()] == [stage.GetEndTimeCode()]
    said = " ".join(capsys.readouterr().out.split())
    assert "Gaussians at one time" in said and "axes: up is Z, and all axes are those of the capture" in said
    for options, words in ((("--up", "X"), "is Y or Z"), (("--time", 2), "from 0"), (("--time", 0, "--times", 2), "give one of them")):
        assert export(finished, *options, "--out", tmp_path / "other.usdc") == 2
        assert words in " ".join(capsys.readouterr().err.split()) and not (tmp_path / "other.usdc").exists()


def moving(t: float) -> Gaussians:
    """Gaussians that drift, spin and fade; the first is never seen, the last only at the end."""
    generator = torch.Generator().manual_seed(5)
    draw = lambda *shape: torch.randn(*shape, generator=generator)  # noqa: E731
    means, quats, drift, spin = draw(50, 3) * 0.5, draw(50, 4), draw(50, 3), draw(50, 4)
    opacities = torch.sigmoid(draw(50) + 2 * t)
    opacities[0], opacities[-1] = 0.001, t
    return Gaussians(means + 0.3 * t * drift, quats + 4 * t * spin, torch.exp(0.3 * draw(50, 3) - 2), opacities, sh=0.3 * draw(50, 9, 3))


def view(gaussians: Gaussians) -> torch.Tensor:
    camera = Camera(torch.tensor([[80.0, 0, 32], [0, 80, 32], [0, 0, 1]]), torch.eye(4), 64, 64)
    camera.cam_from_world[2, 3] = 3.0
    return rasterize(camera, gaussians, None, torch.full((3,), 0.2)).color


@pytest.mark.parametrize("ending", [".usdc", ".usda", ".usd"])
def test_what_is_read_back_renders_the_same(tmp_path, ending):
    times = [0.0, 0.25, 0.5, 1.0]
    assert write_usd(tmp_path / f"a{ending}", moving, times, 8.0, 12.0, Turn("Y", "Y")) == 49
    assert ((tmp_path / f"a{ending}").read_bytes()[:8] == b"PXR-USDC") is (ending != ".usda")
    stage = Usd.Stage.Open(str(tmp_path / f"a{ending}"))
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode(), stage.GetTimeCodesPerSecond()) == (0, 8, 12)
    splats = splats_of(stage)
    for t in times:
        torch.testing.assert_close(view(gaussians_of(splats, 8 * t)), view(moving(t)), atol=2e-5, rtol=0)
    lengths = gaussians_of(splats, 1.0).quats.norm(dim=1)  # between two samples
    torch.testing.assert_close(lengths, torch.ones(49), atol=1e-5, rtol=0)
    before, after = (gaussians_of(splats, 8 * t).quats for t in times[:2])
    assert ((before * after).sum(1) >= 0).all(), "between samples each turns the short way"
    low, high = np.array(splats.GetExtentAttr().Get(0))
    assert (gaussians_of(splats, 0).means.numpy() > low).all() and (gaussians_of(splats, 0).means.numpy() < high).all()


def test_between_samples_a_turning_convex_is_on_its_way(tmp_path):
    rest = torch.randn(30, 8, 3, generator=torch.Generator().manual_seed(2)) * torch.tensor([0.4, 0.2, 0.1])
    fit, one = GaussianFit.uniform(rest, 0.7), torch.ones(30)

    def at(t: float) -> Gaussians:
        turn = torch.from_numpy(Rotation.from_rotvec([3.0 * t, -2.0 * t, 1.0 * t]).as_matrix()).float()
        return fit.gaussians(Convexes(rest @ turn.T + t, one, one, 0.8 * one, sh=torch.zeros(30, 4, 3)))

    def covariances(made: Gaussians) -> torch.Tensor:
        wide = quats_to_matrices(made.quats) * made.scales[:, None]
        return wide @ wide.transpose(1, 2)

    write_usd(tmp_path / "a.usdc", at, np.linspace(0, 1, 9).tolist(), 8.0, 12.0, Turn("Y", "Y"))
    stage = Usd.Stage.Open(str(tmp_path / "a.usdc"))
    splats = splats_of(stage)
    for code in (0.5, 3.5, 7.5):
        torch.testing.assert_close(covariances(gaussians_of(splats, code)), covariances(at(code / 8)), atol=2e-4, rtol=0)


def test_readers_that_ask_for_no_time_find_the_first(tmp_path):
    write_usd(tmp_path / "a.usdc", moving, [0.5, 1.0], 8.0, 12.0, Turn("Y", "Y"))
    stage = Usd.Stage.Open(str(tmp_path / "a.usdc"))
    for attribute in splats_of(stage).GetPrim().GetAuthoredAttributes():
        assert attribute.Get() == attribute.Get(Usd.TimeCode.EarliestTime()), attribute.GetName()
    assert not UsdGeom.BBoxCache(Usd.TimeCode.Default(), ["default"]).ComputeWorldBound(stage.GetDefaultPrim()).GetRange().IsEmpty()


def test_what_cannot_be_drawn_at_every_time_is_left_out(tmp_path):
    def breaks(t: float) -> Gaussians:
        made = moving(t)
        made.means[1] = torch.nan if t else 0.0
        return made

    assert write_usd(tmp_path / "a.usdc", breaks, [0.0, 1.0], 8.0, 12.0, Turn("Y", "Y")) == 48


def test_what_does_not_change_is_stored_once(tmp_path):
    for count in (2, 20):
        write_usd(tmp_path / f"{count}.usdc", moving, np.linspace(0, 1, count).tolist(), 8.0, 12.0, Turn("Z", "Z"))
    grown = (tmp_path / "20.usdc").stat().st_size - (tmp_path / "2.usdc").stat().st_size
    assert grown < 18 * 49 * (3 + 4 + 1) * 4 * 1.3, "18 more samples of positions, orientations and opacities; none of scales and SH"


@pytest.mark.parametrize("up", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (-1, 0, 0), (0, -1, 0), (0, 0, -1)])
def test_the_stage_is_upright(tmp_path, up):
    tilted = np.array(up) + 0.3 * np.array([0.3, -0.5, 0.4])
    for wanted in (None, "Y", "Z", "capture"):
        write_usd(tmp_path / f"{wanted}.usdc", moving, [0.0], 0.0, 24.0, stage_turn(tilted, wanted))
        stage = Usd.Stage.Open(str(tmp_path / f"{wanted}.usdc"))
        shown = UsdGeom.Xformable(splats_of(stage)).ComputeLocalToWorldTransform(0).TransformDir(Gf.Vec3d(*map(float, up)))
        axis = {"Y": (0, 1, 0), "Z": (0, 0, 1)}[UsdGeom.GetStageUpAxis(stage)]
        assert wanted in (None, "capture") or UsdGeom.GetStageUpAxis(stage) == wanted
        np.testing.assert_allclose(np.array(shown), up if wanted == "capture" else axis, atol=1e-9)
    assert nearest_axis(tilted) in ("X", "Y", "Z", "-X", "-Y", "-Z")


@pytest.mark.parametrize("up", [(1, 0, 0), (0, 1, 0), (0, 0, -1)])
@pytest.mark.parametrize("wanted", [None, "Y", "Z"])
def test_the_stage_of_our_own_poses_is_upright_exactly(tmp_path, up, wanted):
    tilted = np.array(up) + 0.3 * np.array([0.3, -0.5, 0.4])
    write_usd(tmp_path / "a.usdc", moving, [0.0], 0.0, 24.0, stage_turn(tilted, wanted, exact=True))
    stage = Usd.Stage.Open(str(tmp_path / "a.usdc"))
    shown = UsdGeom.Xformable(splats_of(stage)).ComputeLocalToWorldTransform(0).TransformDir(Gf.Vec3d(*map(float, tilted)))
    axis = {"Y": (0, 1, 0), "Z": (0, 0, 1)}[UsdGeom.GetStageUpAxis(stage)]
    np.testing.assert_allclose(np.array(shown), np.linalg.norm(tilted) * np.array(axis), atol=1e-9)


@pytest.mark.parametrize("up", [(0, 1, 0), (0, 0, 1), (0, -1, 0)])
def test_validators_find_nothing_and_the_colour_space_is_machine_readable(tmp_path, up):
    path = tmp_path / "a.usda"
    write_usd(path, moving, [0.0, 1.0], 8.0, 24.0, stage_turn(np.array(up)))
    found = UsdValidation.ValidationContext(UsdValidation.ValidationRegistry().GetOrLoadAllValidators()).Validate(Usd.Stage.Open(str(path)))
    assert [str(one.GetMessage()) for one in found] == []
    stage = Usd.Stage.Open(str(path))
    coefficients = splats_of(stage).GetRadianceSphericalHarmonicsCoefficientsAttr()
    assert Usd.ColorSpaceAPI.ComputeColorSpaceName(coefficients, Usd.ColorSpaceHashCache()) == "srgb_rec709_scene"


def test_a_folder_gets_the_scene_s_name(finished, tmp_path):
    assert export(finished, "--times", 2, "--out", tmp_path / "folder") == 0
    assert [f.name for f in (tmp_path / "folder").iterdir()] == [f"{finished[0].root.name}.usdc"]


def test_usd_is_an_ending_too(finished, tmp_path):
    assert export(finished, "--time", 0, "--out", tmp_path / "scene.usd") == 0
    stage = Usd.Stage.Open(str(tmp_path / "scene.usd"))
    assert splats_of(stage) and (tmp_path / "scene.usd").read_bytes()[:8] == b"PXR-USDC"


def test_another_ending_is_refused(finished, tmp_path, capsys):
    assert export(finished, "--out", tmp_path / "scene.obj") == 2
    assert ".usdc or .usda" in " ".join(capsys.readouterr().err.split()) and not list(tmp_path.iterdir())


@pytest.mark.parametrize("ending", ["usdc", "usda"])
def test_a_full_disk_is_one_message_as_for_other_exports(finished, tmp_path, capsys, ending):
    with small_disk(tmp_path / "small", 4_000_000) as disk:
        filler, out = disk.fill(4096), disk.path / f"scene.{ending}"
        assert export(finished, "--times", 2, "--out", out) == 1
        assert capsys.readouterr().err == f"error: export: {out} cannot be written (No space left on device); give another --out\n"
        assert [*disk.path.iterdir()] == [filler], "nothing half-written is left"


def test_without_the_package_it_is_said_how_to_get_it(finished, tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "pxr", None)
    assert export(finished, "--out", tmp_path / "scene.usdc") == 2
    assert "e4dgs[usd]" in capsys.readouterr().err and not list(tmp_path.iterdir())


def test_cameras_come_with_the_scene_and_alone(finished, tmp_path, capsys):
    capture, workspace = finished
    out = tmp_path / "scene.usdc"
    assert export(finished, "--times", 2, "--out", out) == 0
    stage = Usd.Stage.Open(str(out))
    cameras = [UsdGeom.Camera(prim) for prim in stage.Traverse() if prim.IsA(UsdGeom.Camera)]
    assert cameras, "film tools look through the lens that filmed the scene"
    poses = tmp_path / "cameras.json"
    command = ["export", "cameras", str(capture.root), "--workspace", str(workspace), *QUICK]
    assert main([*command, "--out", str(poses)]) == 0
    assert f"cameras: {poses}" in " ".join(capsys.readouterr().out.split())
    assert main(["render", *command[2:], "--path", str(poses), "--out", str(tmp_path / "same")]) == 0
    assert len(list((tmp_path / "same").glob("*.png"))) >= len(cameras)
    assert main([*command, "--time", "0.5"]) == 2
