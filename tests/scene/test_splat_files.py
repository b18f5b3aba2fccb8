"""The compact files of Gaussians: what their parts promise; other programs read them in tests/workflows/test_export_readers.py."""

import gzip
import io
import json
import struct
import zipfile

import numpy as np
import pytest
import torch
from e4dgs.rasterizer import Gaussians
from e4dgs.scene.formats.compressed_ply import compressed_ply_bytes, morton
from e4dgs.scene.formats.ply import ply_bytes
from e4dgs.scene.formats.smallest_three import LARGEST, smallest_three
from e4dgs.scene.formats.sog import sog_bytes
from e4dgs.scene.formats.spz import MOST, cut_by_spz, fraction_bits, spz_bytes
from e4dgs.scene.formats.tables import nearest_numbers, table_of_numbers, table_of_vectors
from PIL import Image


def gaussians(count: int = 100, degree: int = 3, far: float = 0.5) -> Gaussians:
    generator = torch.Generator().manual_seed(3)
    draw = lambda *shape: torch.randn(*shape, generator=generator)  # noqa: E731
    means, scales = draw(count, 3) * far, torch.exp(0.4 * draw(count, 3) - 2.0)
    return Gaussians(means, draw(count, 4), scales, torch.full((count,), 0.7), sh=0.4 * draw(count, (degree + 1) ** 2, 3))


def test_the_left_out_part_follows_from_the_others():
    quats = np.random.default_rng(0).normal(size=(500, 4))
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    left_out, others = smallest_three(quats)
    assert np.abs(others).max() <= LARGEST + 1e-12
    back = np.zeros((500, 4))
    for row, k, three in zip(back, left_out, others):
        row[np.arange(4) != k], row[k] = three, np.sqrt(1 - (three**2).sum())
    np.testing.assert_allclose(np.abs((back * quats).sum(1)), 1, atol=1e-12)


@pytest.mark.parametrize(("far", "bits"), [(0.0, 20), (7.9, 20), (8.1, 19), (2000.0, 12), (MOST, 0)])
def test_positions_of_spz_use_the_bits_that_the_farthest_one_leaves(far, bits):
    assert fraction_bits(far) == bits


def test_what_is_too_far_for_spz_is_said():
    made = gaussians(3)
    made.means[1, 2] = 1e9
    with pytest.raises(ValueError, match="1e\\+09 world units away"):
        spz_bytes(made)


@pytest.mark.parametrize(
    ("unit", "far", "words"),
    [(1.0, 20.0, []), (1e-4, 1e-3, ["standard deviations"]), (1e4, 1e4, ["standard deviations"]), (1.0, 1e6, ["positions to 0.12"])],
)
def test_what_spz_would_cut_is_said(unit, far, words):
    """In other units of length, or with one Gaussian very far away. In the file a Gaussian of 1e4 would be 379."""
    made = gaussians(300)
    made.means, made.scales, made.sh = unit * made.means, unit * made.scales, 0.1 * made.sh
    made.means[0] = torch.tensor([far, 0.0, 0.0])
    found = cut_by_spz(made)
    assert len(found) == len(words) and all(word in line and "export ply" in line for word, line in zip(words, found))


def test_colours_and_sh_that_spz_would_cut_are_counted():
    """A byte of 255 is 127/128, which is what 1 - 1/256 rounds to."""
    made = gaussians(300)
    made.sh = (0.1 * made.sh).clamp(-0.5, 0.5)
    made.sh[0, 5, 1], made.sh[1, 15, 2], made.sh[2, 1, 0], made.sh[3, 0, 1] = 0.995, -1.003, 0.998, -3.3
    assert [line.split(";")[1] for line in cut_by_spz(made)] == [" 1 of 300 Gaussians have some beyond, which are cut"], "only 0.998"
    made.sh[4:9, 0, 2], made.sh[8:10, 0, 0] = 4.0, -4.0
    base, rest = cut_by_spz(made)
    assert base == (
        "SPZ holds base colours of -0.44 to 1.44; 6 of 300 Gaussians have some beyond, which are cut; export ply or sog instead"
    )
    assert "SH above degree 0 of -1 to 0.99" in rest and cut_by_spz(gaussians(300, degree=0)) == []


def test_spz_of_nothing_cuts_nothing():
    made = gaussians(3)
    made.opacities = torch.zeros(3)
    assert cut_by_spz(made) == []


@pytest.mark.parametrize(("degree", "antialiased"), [(0, False), (1, True), (3, False)])
def test_spz_has_the_length_and_the_flag_that_its_header_tells(degree, antialiased):
    file, rows = spz_bytes(gaussians(degree=degree), antialiased)
    data = gzip.decompress(file)
    magic, version, count, found, bits, flags, reserved = struct.unpack_from("<4sIIBBBB", data)
    assert (magic, version, count, found, flags, reserved) == (b"NGSP", 3, rows, degree, int(antialiased), 0) and 0 < bits <= 20
    assert len(data) == 16 + rows * (9 + 1 + 3 + 3 + 4 + 3 * ((degree + 1) ** 2 - 1))


def test_a_curve_keeps_neighbours_together():
    means = np.random.default_rng(1).uniform(size=(4000, 3))
    order = np.argsort(morton(means), kind="stable")
    assert sorted(order) == list(range(4000))
    step = np.linalg.norm(np.diff(means[order], axis=0), axis=1).mean()
    assert step < 0.3 * np.linalg.norm(np.diff(means, axis=0), axis=1).mean()


def test_sog_of_nothing_is_a_gaussian_that_is_transparent():
    made = gaussians(5)
    made.opacities = torch.zeros(5)
    file, rows = sog_bytes(made)
    meta, images = sog_images(file)
    assert (
        rows == 0 and meta["count"] == 1 and meta["shN"]["bands"] == 3 and images["sh0"].shape == (1, 1, 4) and images["sh0"][0, 0, 3] == 0
    )


@pytest.mark.parametrize("writer", [ply_bytes, compressed_ply_bytes, spz_bytes])
def test_nothing_to_be_seen_is_a_file_of_nothing(writer):
    made = gaussians(5)
    made.opacities = torch.zeros(5)
    file, rows = writer(made)
    assert rows == 0 and (b"element vertex 0\n" in file or gzip.decompress(file)[8:12] == b"\0\0\0\0")


def sog_images(file: bytes) -> tuple[dict, dict[str, np.ndarray]]:
    with zipfile.ZipFile(io.BytesIO(file)) as archive:
        found = {name: archive.read(name) for name in archive.namelist()}
    meta = json.loads(found.pop("meta.json"))
    return meta, {name.partition(".")[0]: np.asarray(Image.open(io.BytesIO(data))).astype(int) for name, data in found.items()}


@pytest.mark.parametrize(("degree", "antialiased"), [(0, False), (1, True), (3, False)])
def test_sog_is_decoded_by_its_published_rules(degree, antialiased):
    written = gaussians(500, degree, far=3.0)
    file, rows = sog_bytes(written, antialiased)
    assert sog_bytes(written, antialiased)[0] == file, "the same bytes each time"
    meta, images = sog_images(file)
    assert (meta["version"], meta["count"], meta["antialias"], "shN" in meta) == (2, rows, antialiased, degree > 0)
    assert {name: image.shape[2] for name, image in images.items() if name in ("quats", "sh0")} == {"quats": 4, "sh0": 4}
    flat = {name: image.reshape(-1, image.shape[2])[:rows] for name, image in images.items()}
    share = (flat["means_l"] + 256 * flat["means_u"]) / 65535
    curved = np.array(meta["means"]["mins"]) + share * np.ptp([meta["means"]["mins"], meta["means"]["maxs"]], axis=0)
    means = np.sign(curved) * np.expm1(np.abs(curved))
    nearest = np.linalg.norm(means[None] - written.means.numpy()[:, None], axis=2).argmin(1)
    assert sorted(nearest) == list(range(rows))
    np.testing.assert_allclose(means[nearest], written.means, atol=2e-4 * np.ptp(written.means.numpy()))
    np.testing.assert_allclose(np.array(meta["scales"]["codebook"])[flat["scales"][nearest]], written.scales.log(), atol=0.01)
    np.testing.assert_allclose(np.array(meta["sh0"]["codebook"])[flat["sh0"][nearest, :3]], written.sh[:, 0], atol=0.01)
    assert (flat["sh0"][:, 3] == round(0.7 * 255)).all() and (flat["quats"][:, 3] >= 252).all()
    if degree:
        across = (degree + 1) ** 2 - 1
        vectors = np.array(meta["shN"]["codebook"])[images["shN_centroids"]].reshape(-1, across, 3)
        assert images["shN_centroids"].shape[1] == 64 * across and meta["shN"]["bands"] == degree
        index = flat["shN_labels"][nearest, 0] + 256 * flat["shN_labels"][nearest, 1]
        assert index.max() < meta["shN"]["count"] == rows, "each has its own where there is room"
        np.testing.assert_allclose(vectors[index], written.sh[:, 1:], atol=0.02)


def test_a_table_has_a_vector_for_each_group_of_like_rows():
    rng = np.random.default_rng(2)
    centres = rng.normal(size=(900, 45)).astype(np.float32)
    rows = np.repeat(centres, 1 + np.arange(900) % 4, axis=0)
    rows = (rows + 1e-3 * rng.normal(size=rows.shape)).astype(np.float32)[rng.permutation(len(rows))]
    table, index = table_of_vectors(rows, 1000)
    assert len(table) <= 1000 and np.unique(index).tolist() == list(range(len(table)))
    assert np.abs(table[index] - rows).max() < 0.01
    assert table_of_vectors(rows, len(rows))[0] is rows


def test_a_table_of_numbers_is_dense_where_numbers_are_and_reaches_the_rare_ones():
    rng = np.random.default_rng(3)
    values = np.concatenate([0.1 * rng.normal(size=100_000), [-4.0, 4.0]])
    table = table_of_numbers(values, 256)
    error = np.abs(table[nearest_numbers(values, table)] - values)
    even = 8 / 255
    assert (np.diff(table) > 0).all() and error.max() < even and np.sqrt((error**2).mean()) < 0.5 * even / 12**0.5
    few = table_of_numbers(np.array([3.0, 1.0, 3.0]), 256)
    assert few[nearest_numbers(np.array([1.0, 3.0]), few)].tolist() == [1.0, 3.0] and len(few) == 256
