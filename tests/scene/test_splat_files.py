"""The compact files of Gaussians: what their parts promise; other programs read them in tests/workflows/test_export_readers.py."""

import gzip
import struct

import numpy as np
import pytest
import torch
from e4dgs.rasterizer import Gaussians
from e4dgs.scene.formats.compressed_ply import along_a_curve, compressed_ply_bytes
from e4dgs.scene.formats.ply import ply_bytes
from e4dgs.scene.formats.smallest_three import LARGEST, smallest_three
from e4dgs.scene.formats.spz import MOST, cut_by_spz, fraction_bits, spz_bytes


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
    made.means, made.scales = unit * made.means, unit * made.scales
    made.means[0] = torch.tensor([far, 0.0, 0.0])
    found = cut_by_spz(made)
    assert len(found) == len(words) and all(word in line and "export ply" in line for word, line in zip(words, found))


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
    order = along_a_curve(means)
    assert sorted(order) == list(range(4000))
    step = np.linalg.norm(np.diff(means[order], axis=0), axis=1).mean()
    assert step < 0.3 * np.linalg.norm(np.diff(means, axis=0), axis=1).mean()


@pytest.mark.parametrize("writer", [ply_bytes, compressed_ply_bytes, spz_bytes])
def test_nothing_to_be_seen_is_a_file_of_nothing(writer):
    made = gaussians(5)
    made.opacities = torch.zeros(5)
    file, rows = writer(made)
    assert rows == 0 and (b"element vertex 0\n" in file or gzip.decompress(file)[8:12] == b"\0\0\0\0")
