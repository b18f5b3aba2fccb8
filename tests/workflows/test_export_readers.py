"""Exports as other programs read them: splat-transform, plyfile, three.js and the Khronos validator.

Programs from npm are looked for where E4DGS_NPM says, then by `npx --no-install`; benchmarks/export_readers.py says what to install.
"""

import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from e4dgs.rasterizer import Camera, Convexes, Gaussians
from e4dgs.scene.hull_mesh import hull_mesh
from e4dgs.scene.mesh import mesh_glb_bytes
from e4dgs.scene.rotation import quats_to_matrices
from e4dgs.stages.exports.splats import KINDS, encoder

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))

import export_readers as readers
import exports
from export_errors import errors, psnr

# What each format can hold: positions of the scene's size, ln of scales, degrees, opacity, the constant coefficient of SH, the others.
EXACT = (0.0, 1e-6, 1e-4, 1e-6, 1e-6, 1e-6)
PRECISION = {
    "ply": EXACT,
    "compressed-ply": (3e-3, 4e-3, 0.25, 0.5 / 255, 0.02, 4 / 256),  # 10 or 11 bits in the box of a chunk; SH in steps of 1/32
    "spz": (1e-6, 0.5 / 16, 0.25, 0.5 / 255, 0.5 / 255 / 0.15, 0.5 / 128),  # 24 bits; steps of 1/16; ...; SH in steps of 1/128
    "sog": (2e-4, 0.05, 1.0, 0.5 / 255, 0.05, 0.2),  # 16 bits; tables of 256 values for scales and colours; SH by a table of vectors
}
LEAST_PSNR = {"ply": 90.0, "compressed-ply": 45.0, "spz": 45.0, "sog": 40.0}


@pytest.fixture(scope="module")
def transform():
    return readers.splat_transform() or pytest.skip("needs splat-transform: npm install @playcanvas/splat-transform, and E4DGS_NPM")


@pytest.fixture(scope="module")
def modules():
    return readers.node_modules() or pytest.skip("needs node, and three and gltf-validator from npm: npm install, and E4DGS_NPM")


def gaussians(count: int = 400, degree: int = 3) -> Gaussians:
    generator = torch.Generator().manual_seed(5)
    draw = lambda *shape: torch.randn(*shape, generator=generator)  # noqa: E731
    means, scales = draw(count, 3) * 0.5, torch.exp(0.4 * draw(count, 3) - 2.5)
    opacities = torch.rand(count, generator=generator) * 0.98 + 0.01
    return Gaussians(means, 3 * draw(count, 4), scales, opacities, sh=0.1 * draw(count, (degree + 1) ** 2, 3))


def camera() -> Camera:
    pose = torch.eye(4)
    pose[2, 3] = 3.0
    return Camera(torch.tensor([[80.0, 0, 32], [0, 80, 32], [0, 0, 1]]), pose, 64, 64)


def agree(kind: str, written: Gaussians, read: Gaussians) -> None:
    found = errors(written, read)
    assert found["lost"] == found["shared"] == 0 and found["sh_coefficients"] == written.sh.shape[1]
    for name, most in zip(("relative", "scale", "rotation", "opacity", "color", "sh"), PRECISION.get(kind, EXACT)):
        assert found[name] <= 1.01 * most + 1e-7, f"{kind}: {name}: {found}"
    assert psnr(written, read, [camera()], (0.2, 0.2, 0.2)) >= LEAST_PSNR.get(kind, 90.0)


@pytest.mark.parametrize("kind", PRECISION)
def test_splat_transform_reads_what_was_written(kind, transform, tmp_path):
    file = tmp_path / f"frame{KINDS[kind]}"
    file.write_bytes(encoder(kind)(gaussians())[0])
    agree(kind, gaussians(), readers.by_splat_transform(transform, file))


def test_plyfile_reads_what_was_written(tmp_path):
    pytest.importorskip("plyfile")
    file = tmp_path / "frame.ply"
    file.write_bytes(encoder("ply")(gaussians())[0])
    agree("ply", gaussians(), readers.by_plyfile(file))


def test_three_reads_splats_of_gltf_and_the_validator_has_no_error(modules, tmp_path):
    file, made = tmp_path / "frame.glb", gaussians(degree=2)
    file.write_bytes(encoder("gltf")(made)[0])
    read = readers.by_three(modules, file)
    assert readers.errors_of_standard_parts(read) == [] and read["issues"]["numHints"] == 0
    agree("gltf", made, readers.gaussians_of_three(read))
    # What three's own reader of KHR_gaussian_splatting makes of scales and rotations: xx xy xz yy yz zz.
    (found,) = read["splats"]
    wide = quats_to_matrices(made.quats) * made.scales[:, None]
    rows, columns = np.triu_indices(3)
    np.testing.assert_allclose(found, (wide @ wide.transpose(1, 2)).numpy()[:, rows, columns], atol=1e-6)


def test_the_validator_s_errors_count_but_for_names_of_the_extension(modules, tmp_path):
    """A wrong box of positions is found: the check can fail."""
    file = tmp_path / "frame.glb"
    data = encoder("gltf")(gaussians(20))[0]
    before = data[data.index(b'"max":[') :].split(b"]")[0]
    file.write_bytes(data.replace(before, b'"max":[9.' + b"0" * (len(before) - 13) + b",9,9", 1))
    assert any("ACCESSOR_MAX_MISMATCH" in error for error in readers.errors_of_standard_parts(readers.by_three(modules, file)))


def test_three_plays_convexes_one_moment_after_the_other(modules, tmp_path):
    points = torch.randn(3, 6, 3, generator=torch.Generator().manual_seed(2))
    sh = torch.tensor([[1.0, 0.2, 0.1], [0.1, 0.6, 0.3], [0.2, 0.2, 0.9]])[:, None]
    convexes = [Convexes(points + k, torch.ones(3), torch.ones(3), torch.ones(3) * 0.7, sh=sh) for k in range(2)]
    made = [hull_mesh(one) for one in convexes]
    file = tmp_path / "hulls.glb"
    file.write_bytes(mesh_glb_bytes(made, [0.0, 0.5]))
    read = readers.by_three(modules, file)
    assert readers.errors_of_standard_parts(read) == [] and read["issues"]["numHints"] == 0
    found = exports.unlike(made, [(mesh["attributes"]["position"], mesh["indices"]) for mesh in read["meshes"]])
    assert found["lost"] == 0 and found["position"] == 0
    (animation,) = read["animations"]
    shown = {track["name"]: dict(zip(track["times"], np.reshape(track["values"], (-1, 3))[:, 0])) for track in animation["tracks"]}
    assert shown["frame0001.scale"] == {0.0: 1, 0.5: 0} and shown["frame0002.scale"][0.0] == 0 and shown["frame0002.scale"][0.5] == 1
