"""Pairs of images have the same matches however many processes find them, and a killed process goes on where it stopped."""

import sqlite3

import cv2
import numpy as np
import pycolmap
import pytest
from e4dgs.vision.sfm.worker.features import matching
from e4dgs.vision.sfm.worker.features.database import extract, write_cameras
from PIL import Image

IMAGES, SEED = 8, 3
NAMES = [f"{i}.png" for i in range(IMAGES)]
PAIRS = [(a, b) for a in range(IMAGES) for b in range(a + 1, IMAGES)]


@pytest.fixture(scope="module")
def features(tmp_path_factory):
    """A folder with pictures of the same noise, moved by 5 px each, and a database with 600 features of each."""
    folder = tmp_path_factory.mktemp("features")
    noise = np.random.default_rng(0).normal(size=(260, 400))
    grey = np.clip(128 + 400 * cv2.GaussianBlur(noise, (0, 0), 1.5), 0, 255).astype(np.uint8)
    for i, name in enumerate(NAMES):
        Image.fromarray(grey[:240, 5 * i : 5 * i + 320]).save(folder / name)
    cameras = write_cameras(folder / "features.db", [pycolmap.infer_camera_from_image(folder / NAMES[0])]) * IMAGES
    extract(folder / "features.db", folder, NAMES, cameras, 600, lambda *_: None)
    return folder / "features.db"


@pytest.fixture
def small_chunks(monkeypatch):
    monkeypatch.setattr(matching, "MATCH_CHUNK", 5)


def matched(features, folder, threads, monkeypatch, verify=True):
    """(rows of both tables, progress) of all pairs, found by `threads` processes."""
    path, told = folder / f"{threads}.db", []
    copy(features, path)
    monkeypatch.setattr(matching, "thread_count", lambda most: min(most, threads))
    matching.match(path, NAMES, PAIRS, SEED, verify, lambda _, done, total: told.append((done, total)))
    return {table: rows(path, table) for table in matching.RESULTS}, told


def copy(source, target):
    old, new = sqlite3.connect(source), sqlite3.connect(target)
    old.backup(new)
    old.close()
    new.close()


def rows(path, table):
    database = sqlite3.connect(path)
    try:
        return database.execute(f"SELECT * FROM {table} ORDER BY pair_id").fetchall()
    finally:
        database.close()


@pytest.mark.parametrize("verify", [True, False])
def test_processes_find_what_one_finds(features, small_chunks, tmp_path, monkeypatch, verify):
    alone, _ = matched(features, tmp_path, 1, monkeypatch, verify)
    shared, told = matched(features, tmp_path, 3, monkeypatch, verify)
    assert len(alone["matches"]) == len(PAIRS) and len(alone["two_view_geometries"]) == verify * len(PAIRS)
    assert np.mean([row[1] for row in alone["matches"]]) > 100, "matches in each pair"
    assert shared == alone
    assert told[0] == (0, len(PAIRS)) and told[-1] == (len(PAIRS), len(PAIRS)) and told == sorted(told)
    assert sorted(file.name for file in tmp_path.iterdir() if file.is_dir()) == [], "no process leaves anything behind"


def test_a_killed_run_goes_on_with_what_its_processes_found(features, small_chunks, tmp_path, monkeypatch):
    alone, _ = matched(features, tmp_path, 1, monkeypatch)

    def killed(request, folder, progress=None):
        folder.mkdir(exist_ok=True)
        if folder.name.endswith("1"):
            raise KeyboardInterrupt
        matching.match_share({**request, "folder": str(folder)}, lambda *_: None)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(matching, "run_worker", killed)
        matched(features, tmp_path, 2, monkeypatch)
    assert rows(tmp_path / "2.db", "matches") == [], "what is unfinished lies with the processes"
    told = []
    matching.match(tmp_path / "2.db", NAMES, PAIRS, SEED, True, lambda _, done, total: told.append(done))
    assert {table: rows(tmp_path / "2.db", table) for table in matching.RESULTS} == alone
    assert len(PAIRS) // 2 in told[:3], "the first process had nothing left to do"


def test_pairs_without_verification_are_verified(features, tmp_path, monkeypatch):
    raw, _ = matched(features, tmp_path, 1, monkeypatch, verify=False)
    matching.match(tmp_path / "1.db", NAMES, PAIRS, SEED, True, lambda *_: None)
    assert rows(tmp_path / "1.db", "matches") == raw["matches"]
    assert len(rows(tmp_path / "1.db", "two_view_geometries")) == len(PAIRS)
