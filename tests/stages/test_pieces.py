"""Models as straight pieces, and the open 4D files that hold them: what others decode is what was exported."""

import numpy as np
import pytest
import torch
from e4dgs.rasterizer import rasterize
from e4dgs.scene.convex_gaussians import GaussianFit
from e4dgs.scene.formats.axes import Turn
from e4dgs.scene.formats.freetime import freetime_bytes, read_freetime
from e4dgs.scene.formats.gaussian_birth import Clock, View, container_bytes, read_container
from e4dgs.scene.motion.lifetimes.lifetime import lifetime
from e4dgs.scene.primitives import SH_C0
from e4dgs.stages.exports.bake import Baked, Loss
from e4dgs.stages.exports.plain import PlainLook
from e4dgs.stages.exports.straight import pieces as of_pieces
from e4dgs.stages.exports.straight.colors import fitting_colors
from e4dgs.stages.exports.straight.export import ExportedStraight
from e4dgs.stages.exports.straight.pieces import halvings, pieces_of, still_pieces, turned_pieces
from e4dgs.stages.exports.straight.soft import soft_pieces
from made_models import FRAMES, MOTIONS, camera, made

PIXEL = 3.0 / 150
TIMES = 0.0, 0.25, 0.5, 0.75, 1.0
CLOCK = Clock(1.0, FRAMES / (FRAMES - 1))
VIEW = View(50.0, np.array([0.0, 0.0, -3.0]), np.zeros(3))


def baked(motion: str, slow: float = 1.0, spin: float = 1.0, bright: float = 1.0, degree: int = 2) -> Baked:
    """A model with Gaussians in place of its convexes; ``slow`` scales what moves, ``spin`` what lives turn, ``bright`` contrast."""
    model = made(motion, degree, gaussians=300, convexes=30, antialiased=False)
    with torch.no_grad():
        for one in (model.gaussians, model.convexes):
            one.sh_dc.mul_(bright)
            if "shades" in one.parameters:
                one.shades.mul_(0.1)  # colours stay in [0, 1], which is all that the containers hold
            if "spins" in one.parameters:
                one.spins.mul_(spin)
        if motion == "planes":
            model.motion.head.weight.mul_(slow)
        if motion == "nodes":
            model.motion.network.place[-1].weight.mul_(slow)
    return Baked(model, GaussianFit.uniform(model.convexes.points.detach(), 0.8), PlainLook.unchanged(len(model.gaussians)))


def psnr(source: Baked, shown, t: float) -> float:
    view, background = camera(2 * t), torch.tensor(source.model.background)
    with torch.no_grad():
        pair = [rasterize(view, one, None, background).color.clamp(0, 1) for one in (source.at(t), shown)]
    return float(-10 * (pair[0] - pair[1]).square().mean().clamp(min=1e-12).log10())


@pytest.mark.parametrize("motion", MOTIONS)
def test_a_4dgs_file_is_decoded_to_the_model_by_its_own_package(motion):
    pytest.importorskip("fourdgs")
    from fourdgs.validate import validate

    source = baked(motion, slow=0.4)
    pieces = pieces_of(source, FRAMES, PIXEL)
    data = container_bytes(pieces, CLOCK, Turn("-Y", "-Y"), VIEW, "made")
    assert not [one for one in validate(data).findings if one.severity == "error"]
    at = read_container(data)
    found = [(psnr(source, pieces.at(t), t), psnr(source, at(CLOCK.span * t), t)) for t in TIMES]
    assert min(exact for exact, _ in found) > 42 and min(decoded for _, decoded in found) >= 40, found
    assert motion != "static" or len(pieces) == 330


@pytest.mark.parametrize(("motion", "degree"), [("static", 0), ("lives", 2), ("nodes", 1), ("planes", 3)])
def test_colours_beyond_what_the_container_holds_come_back(motion, degree):
    """As a model has them that was hardly trained: a seventh and more of all colours, by up to 0.7."""
    pytest.importorskip("fourdgs")
    source = baked(motion, slow=0.4, spin=0.2, bright=1.8, degree=degree)
    pieces = pieces_of(source, FRAMES, PIXEL)
    colors = 0.5 + SH_C0 * pieces.gaussians.sh[:, 0]
    assert float(((colors < 0) | (colors > 1)).float().mean()) > 1 / 7
    poses = torch.stack([camera(float(angle)).cam_from_world for angle in np.arange(0, 6.28, 0.3)])
    eyes = -(poses[:, :3, :3].transpose(1, 2) @ poses[:, :3, 3:])[..., 0]
    found = []
    for written in (pieces, fitting_colors(pieces, eyes)):
        at = read_container(container_bytes(written, CLOCK, Turn("-Y", "-Y"), VIEW, "made"))
        found.append(min(psnr(source, at(CLOCK.span * t), t) for t in TIMES))
    assert found[0] < 34 and found[1] >= 40, found


def test_colours_that_fit_are_left_as_they_are():
    pieces = still_pieces(baked("static"), 0.5)
    inside = pieces.select((0.5 + SH_C0 * pieces.gaussians.sh[:, 0] - 0.5).abs().amax(1).lt(0.5).nonzero()[:, 0])
    assert len(inside) > 100 and fitting_colors(inside, torch.eye(3)) is inside


def test_a_straight_life_is_one_piece_with_its_own_times():
    source = baked("lives", spin=0.0)
    pieces = pieces_of(source, FRAMES, PIXEL)
    model = source.model
    assert len(pieces) <= len(model.gaussians) + len(model.convexes), "only what is never seen is left out"
    assert bool((pieces.low == -torch.inf).all()) and bool((pieces.high == torch.inf).all())
    lives = {round(float(m), 9) for m in lifetime(model.gaussians).times.detach().double() / (FRAMES - 1)}
    assert {round(float(m), 9) for m in pieces.middles[pieces.spreads.isfinite()]} & lives
    back = read_freetime(freetime_bytes(soft_pieces(source, FRAMES, PIXEL), FRAMES))
    assert min(psnr(source, back.at(t), t) for t in TIMES) > 50


def test_pieces_of_a_gaussian_follow_one_another_without_gap_or_overlap():
    source = baked("nodes", slow=0.4)
    pieces = pieces_of(source, FRAMES, PIXEL)
    count = len(source.at(0.0).means)
    faint = int((source.at(0.0).opacities < 1 / 255).sum())
    for t in np.linspace(0, 1, 41):
        assert len(pieces.at(float(t)).means) == count - faint


@pytest.mark.parametrize(("motion", "slow", "bar"), [("planes", 0.15, 40), ("nodes", 0.05, 36)])
def test_soft_pieces_of_what_bends_stay_near_it(motion, slow, bar):
    source = baked(motion, slow)
    pieces = soft_pieces(source, FRAMES, PIXEL)
    back = read_freetime(freetime_bytes(pieces, FRAMES))
    found = [psnr(source, back.at(t), t) for t in (0.1, *TIMES, 0.63)]
    assert min(found) > bar, found


def test_pieces_that_memory_keeps_long_are_told(monkeypatch):
    source = baked("nodes")
    assert halvings(source, FRAMES) == (6, 6)
    whole = pieces_of(source, FRAMES, PIXEL)
    monkeypatch.setattr(of_pieces, "MOST_BYTES", 16 * 330 * 56)  # 16 intervals between samples
    assert halvings(source, FRAMES) == (3, 6)
    few = pieces_of(source, FRAMES, PIXEL)
    lengths = [float((one.high - one.low)[(one.low > 0) & (one.high < 1)].min()) for one in (whole, few)]
    assert lengths == [1 / 64, 1 / 8]
    done = ExportedStraight(330, len(few), 40.0, Loss(40.0, 4, 0), Turn("Y", "Y"), 1000, 8.0, 1.0)
    assert "straight pieces, none shorter than 1 s, which is all that memory allows; " in str(done)


def test_a_freetime_file_has_the_names_and_units_of_its_layout():
    """Independent of our reader: header lines, and a row by hand."""
    source = baked("lives", spin=0.0)
    pieces = soft_pieces(source, FRAMES, PIXEL)
    head, _, body = freetime_bytes(pieces, FRAMES).partition(b"end_header\n")
    lines = head.decode().splitlines()
    for line in ("ftgs_version 1", "time_units normalized", "sh_degree 2", "use_velocity 1", "opacity_floor 0", f"n_frames {FRAMES}"):
        assert f"comment {line}" in lines
    names = [line.split()[2] for line in lines if line.startswith("property float")]
    assert names[-5:] == ["time", "log_duration", "velocity_0", "velocity_1", "velocity_2"] and names.count("f_rest_23") == 1
    table = np.frombuffer(body, "<f4").reshape(-1, len(names))
    k = int(torch.nonzero(pieces.spreads.isfinite())[0])
    row = dict(zip(names, table[k]))
    t = 0.4
    where = np.array([row[c] + row[f"velocity_{j}"] * (t - row["time"]) for j, c in enumerate("xyz")])
    own = pieces.gaussians.means[k].double() + pieces.velocities[k] * (t - pieces.middles[k])
    assert np.allclose(where, own.numpy(), atol=1e-4)
    assert np.exp(row["log_duration"]) == pytest.approx(float(pieces.spreads[k]), rel=1e-4)
    with pytest.raises(ValueError, match="no PLY file of FreeTimeGS"):
        read_freetime(b"ply\nend_header\n")


def test_files_stand_in_their_own_axes_and_say_so():
    fourdgs = pytest.importorskip("fourdgs")
    source, turn = baked("static"), Turn("-Y", "Y")
    pieces = still_pieces(source, 0.5)
    scene = fourdgs.read(container_bytes(turned_pieces(pieces, turn), Clock(1.0, 1.0), turn, VIEW, "made"))
    (frame,) = scene.provenance.frames
    assert (frame.handedness, frame.up_axis, frame.forward_axis) == (1, 1, 5) and scene.camera.fov_y_deg == 50
    assert scene.header.attributes["color_space"] == "srgb-rec709-display" and scene.header.temporal_model == "gaussian-birth"
    state = scene.gaussians.state_at(0.0, scene.header.cutoff)
    first = np.sort(state["centers"][:, 1])
    assert np.allclose(first, np.sort(-pieces.gaussians.means[:, 1].numpy()), atol=3e-3), "what was down is up"
    colors = np.sort((0.5 + SH_C0 * pieces.gaussians.sh[:, 0, 0]).clamp(0, 1).numpy())
    assert np.allclose(np.sort(scene.gaussians.colors[:, 0]), colors, atol=3e-3)
