"""PLY files hold what viewers of 3D Gaussian Splatting expect, and what is read back renders as the model does."""

import json
import struct
from dataclasses import replace

import numpy as np
import pytest
import torch
from e4dgs.rasterizer import Camera, Gaussians, rasterize
from e4dgs.scene.formats.compressed_ply import compressed_ply_bytes
from e4dgs.scene.formats.gltf import glb_bytes
from e4dgs.scene.formats.ply import LEAST_ALPHA, ply_bytes
from e4dgs.scene.formats.spz import spz_bytes


def gaussians(count: int = 200, degree: int = 2) -> Gaussians:
    generator = torch.Generator().manual_seed(3)
    draw = lambda *shape: torch.randn(*shape, generator=generator)  # noqa: E731
    means, scales = draw(count, 3) * 0.5, torch.exp(0.4 * draw(count, 3) - 2.5)
    return Gaussians(means, 3 * draw(count, 4), scales, torch.sigmoid(draw(count)), sh=0.3 * draw(count, (degree + 1) ** 2, 3))


def read(file: bytes) -> tuple[list[str], np.ndarray]:
    """Names and table [N, columns], by the header alone."""
    header, body = file.split(b"end_header\n", 1)
    lines = header.decode().splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    names = [line.split()[2] for line in lines if line.startswith("property float ")]
    table = np.frombuffer(body, "<f4").reshape(-1, len(names))
    assert f"element vertex {len(table)}" in lines
    return names, table


def as_a_viewer_reads(file: bytes) -> Gaussians:
    """By the layout's definition: SH of a channel lie together, scales are logarithms, opacity a logit."""
    names, table = read(file)
    column = {name: torch.tensor(table[:, k].copy()) for k, name in enumerate(names)}
    of = lambda prefix, n: torch.stack([column[f"{prefix}_{k}"] for k in range(n)], 1)  # noqa: E731
    rest = of("f_rest", sum(name.startswith("f_rest_") for name in names)).reshape(len(table), 3, -1)
    sh = torch.cat([of("f_dc", 3)[:, None], rest.transpose(1, 2)], 1)
    means = torch.stack([column[axis] for axis in "xyz"], 1)
    return Gaussians(means, of("rot", 4), of("scale", 3).exp(), torch.sigmoid(column["opacity"]), sh=sh)


def view(kind: Gaussians) -> torch.Tensor:
    camera = Camera(torch.tensor([[80.0, 0, 32], [0, 80, 32], [0, 0, 1]]), torch.eye(4), 64, 64)
    camera.cam_from_world[2, 3] = 3.0
    return rasterize(camera, kind, None, torch.full((3,), 0.2)).color.clamp(0, 1)


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_what_is_read_back_renders_the_same(degree):
    made = gaussians(degree=degree)
    file, rows = ply_bytes(made)
    assert rows == 200
    back = as_a_viewer_reads(file)
    np.testing.assert_allclose(back.means, made.means, atol=1e-6)
    error = (view(back) - view(made)).square().mean()
    assert -10 * torch.log10(error.clamp(min=1e-12)) > 60


def of_glb(file: bytes) -> tuple[dict, dict[str, np.ndarray]]:
    """JSON and attributes by name, by the definition of binary glTF."""
    magic, version, size = struct.unpack_from("<4sII", file)
    length, kind = struct.unpack_from("<II", file, 12)
    assert (magic, version, size, kind) == (b"glTF", 2, len(file), 0x4E4F534A) and length % 4 == 0
    content = json.loads(file[20 : 20 + length])
    binary = file[20 + length + 8 :]
    assert struct.unpack_from("<II", file, 20 + length) == (content["buffers"][0]["byteLength"], 0x004E4942) and len(binary) % 4 == 0
    found = {}
    for name, k in content["meshes"][0]["primitives"][0]["attributes"].items():
        accessor, width = content["accessors"][k], {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[content["accessors"][k]["type"]]
        where = content["bufferViews"][accessor["bufferView"]]
        found[name] = np.frombuffer(binary, "<f4", accessor["count"] * width, where["byteOffset"]).reshape(-1, width)
    return content, found


@pytest.mark.parametrize("degree", [0, 2, 3])
def test_gltf_that_is_read_back_renders_the_same(degree):
    made = gaussians(degree=degree)
    file, rows = glb_bytes(made)
    content, found = of_glb(file)
    assert rows == 200 and content["extensionsUsed"] == ["KHR_gaussian_splatting"]
    primitive = content["meshes"][0]["primitives"][0]
    assert primitive["mode"] == 0 and primitive["extensions"]["KHR_gaussian_splatting"]["kernel"] == "ellipse"
    named = {name.removeprefix("KHR_gaussian_splatting:"): torch.tensor(value.copy()) for name, value in found.items()}
    order = [f"SH_DEGREE_{d}_COEF_{n}" for d in range(degree + 1) for n in range(2 * d + 1)]
    assert sum(name.startswith("SH_") for name in named) == len(order)
    sh = torch.stack([named[name] for name in order], 1)
    quats = named["ROTATION"][:, [3, 0, 1, 2]]
    back = Gaussians(named["POSITION"], quats, named["SCALE"], named["OPACITY"][:, 0], sh=sh)
    error = (view(back) - view(made)).square().mean()
    assert -10 * torch.log10(error.clamp(min=1e-12)) > 60
    bounds = content["accessors"][0]
    assert (found["POSITION"].min(0) == np.float32(bounds["min"])).all() and (found["POSITION"].max(0) == np.float32(bounds["max"])).all()
    assert named["COLOR_0"].min() >= 0 and named["COLOR_0"].max() <= 1


def test_colours_of_points_in_gltf_are_linear_light():
    """As the extension asks for: the sRGB value 0.5 is 0.2140 of the light (IEC 61966-2-1)."""
    made = gaussians(degree=0)
    made.sh = torch.zeros_like(made.sh)
    np.testing.assert_allclose(of_glb(glb_bytes(made)[0])[1]["COLOR_0"][:, :3], 0.21404, atol=1e-5)


def test_gltf_of_nothing_has_no_empty_accessor():
    file, rows = glb_bytes(replace(gaussians(3), opacities=torch.zeros(3)))
    content = json.loads(file[20:])
    assert rows == 0 and content["nodes"] == [{"name": "splats"}] and "accessors" not in content


def test_columns_are_those_that_viewers_ask_for():
    names, table = read(ply_bytes(gaussians(degree=1))[0])
    assert names[:9] == ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"]
    assert names[9:54] == [f"f_rest_{k}" for k in range(45)], "the readers of 3DGS and Unity expect all of degree 3"
    rest = table[:, 9:54].reshape(-1, 3, 15)
    assert rest[:, :, :3].any() and not rest[:, :, 3:].any(), "channel after channel; 0 above its own degree"
    assert names[54:] == ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
    np.testing.assert_allclose(np.linalg.norm(table[:, -4:], axis=1), 1, atol=1e-6)


def test_what_cannot_be_seen_is_left_out_at_the_rasterizer_s_threshold():
    made = gaussians(3)
    made.opacities = torch.tensor([LEAST_ALPHA, LEAST_ALPHA - 1e-5, 1.0])
    file, rows = ply_bytes(made)
    assert rows == 2 and np.isfinite(read(file)[1]).all()


def test_what_the_rasterizer_does_not_draw_is_in_no_file():
    """One such Gaussian would leave all of its chunk of a compressed file without a box."""
    made, whole = gaussians(200), gaussians(200)
    made.sh[3, 0, 0] = made.scales[4, 1] = torch.nan
    made.scales[5, 2], made.scales[6, 0], made.quats[7] = torch.inf, 0.0, 0.0
    for field in ("means", "quats", "scales", "opacities", "sh"):
        value = getattr(whole, field)
        setattr(whole, field, torch.cat([value[:3], value[8:]]))
    for write in (ply_bytes, compressed_ply_bytes, spz_bytes, glb_bytes):
        assert write(made) == write(whole)


def test_the_header_says_what_is_asked_and_is_still_read():
    header = ply_bytes(gaussians(degree=1), ["SplatRenderMode: mip", "up: -Y"])[0].split(b"end_header")[0].decode().split("\n")
    assert header[1:4] == ["format binary_little_endian 1.0", "comment SplatRenderMode: mip", "comment up: -Y"]
