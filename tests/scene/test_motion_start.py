"""A field that is fitted to tracks goes where they go, and the same way each time."""

import numpy as np
import torch
from e4dgs.scene.motion.field import DeformationField
from e4dgs.scene.settings import TrainingSettings
from e4dgs.scene.training.motion_start import follow_tracks

TIMES = 12


def tracks() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A ball of points that turns by a quarter and travels by its own size; every other track is lost in the last third."""
    rng = np.random.default_rng(0)
    rest = rng.normal(0, 0.3, (400, 3)).astype(np.float32)
    times, positions = np.linspace(0, 1, TIMES), np.zeros((TIMES, 400, 3), np.float32)
    for k, t in enumerate(times):
        a = 0.5 * np.pi * (t - 0.5)
        turn = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
        positions[k] = rest @ turn.T + np.array([2 * (t - 0.5), 0, 0])
    alive = np.ones((TIMES, 400), bool)
    alive[2 * TIMES // 3 :, ::2] = False
    positions[~alive] = 1e6  # must not be read
    return rest, times, positions, alive


def fitted() -> tuple[DeformationField, float]:
    field = DeformationField(torch.full((3,), -1.5), torch.full((3,), 1.5), TIMES)
    return field, follow_tracks(field, *tracks(), unit=4.0, settings=TrainingSettings.model_validate({}))


def test_the_field_goes_where_the_tracks_go():
    field, error = fitted()
    assert error < 0.01 * 4.0
    rest, times, positions, _ = tracks()
    with torch.no_grad():
        there = torch.from_numpy(rest) + field(torch.from_numpy(rest), float(times[0])).dx
    off = np.linalg.norm(there.numpy() - positions[0], axis=1)
    assert np.median(off) < 0.04 and np.median(np.linalg.norm(positions[0] - rest, axis=1)) > 0.9


def test_lost_tracks_follow_those_beside_them():
    field, _ = fitted()
    rest, _, positions, alive = tracks()
    kept = alive[-1]
    true = rest + (positions[-1, kept] - rest[kept]).mean(0)
    with torch.no_grad():
        there = (torch.from_numpy(rest) + field(torch.from_numpy(rest), 1.0).dx).numpy()
    assert np.linalg.norm(there[~kept] - true[~kept], axis=1).mean() < 0.5


def test_the_fit_is_the_same_twice():
    a, b = fitted(), fitted()
    assert a[1] == b[1]
    assert all(torch.equal(p, q) for p, q in zip(a[0].state_dict().values(), b[0].state_dict().values(), strict=True))
