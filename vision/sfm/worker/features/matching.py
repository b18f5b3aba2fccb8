"""`match`: matches pairs of images, in a process of one thread for each core. Runs in the worker process: imports pycolmap."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from .....pipeline import thread_count
from .....pipeline.files import written_beside
from ...pairs import MATCHERS
from ...runner import run_worker
from .database import MATCH_CHUNK, Report, image_ids, list_pairs

RESULTS = ("matches", "two_view_geometries")  # tables of COLMAP's database


def match(path: Path, names: Sequence[str], pairs: Sequence[tuple[int, int]], seed: int, verify: bool, report: Report) -> None:
    """Matches the pairs (indices into `names`); those that have matches are skipped. `verify` also estimates the two-view geometry of
    each, which needs no poses.

    COLMAP 4.2 searches for neighbours with faiss and its own OpenBLAS. With two threads 4 of 89 calls gave other matches, with one
    none of 587 did. So each process has one thread, and a copy of the features.
    """
    todo = _unmatched(path, names, pairs, verify)
    done = len(pairs) - len(todo)
    report("matches", done, len(pairs))
    count = min(thread_count(MATCHERS), -(-len(todo) // MATCH_CHUNK))
    if count < 2:
        _match(path, names, todo, seed, verify, lambda k: report("matches", done + k, len(pairs)))
        return
    finished = [0] * count
    folders = [path.with_name(f"{path.stem}-match{k}") for k in range(count)]

    def share(k: int) -> None:
        mine = [todo[i] for i in range(k * len(todo) // count, (k + 1) * len(todo) // count)]
        request = {"task": "match", "source": str(path), "names": list(names), "pairs": mine, "seed": seed, "verify": verify}

        def advance(_: str, matched: int, __: int) -> None:
            finished[k] = matched
            report("matches", done + sum(finished), len(pairs))

        run_worker(request, folders[k], advance)

    with ThreadPoolExecutor(count) as pool:
        list(pool.map(share, range(count)))
    for folder in folders:
        _take(path, folder / path.name)
        _remove(folder)


def match_share(request: dict[str, Any], report: Report) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """The task of one process: a copy of the database `source` gets the matches of its pairs. A run that was killed goes on with it."""
    source, folder, pairs = Path(request["source"]), Path(request["folder"]), [(int(a), int(b)) for a, b in request["pairs"]]
    path = folder / source.name
    if not path.exists():
        with written_beside(path) as part, closing(sqlite3.connect(source)) as old, closing(sqlite3.connect(part)) as new:
            old.backup(new)
    seed, verify = int(request["seed"]), bool(request["verify"])
    todo = _unmatched(path, request["names"], pairs, verify)
    done = len(pairs) - len(todo)
    _match(path, request["names"], todo, seed, verify, lambda k: report("matches", done + k, len(pairs)))
    return {}, {}


def _match(
    path: Path, names: Sequence[str], pairs: Sequence[tuple[int, int]], seed: int, verify: bool, advance: Callable[[int], None]
) -> None:
    matching = pycolmap.FeatureMatchingOptions()
    matching.skip_geometric_verification, matching.num_threads = not verify, 1
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = seed
    pairing = pycolmap.ImportedPairingOptions()
    pairing.match_list_path = path.with_suffix(".pairs.txt")
    for start in range(0, len(pairs), MATCH_CHUNK):
        list_pairs(pairing.match_list_path, names, pairs[start : start + MATCH_CHUNK])
        pycolmap.match_image_pairs(path, matching_options=matching, pairing_options=pairing, verification_options=verification)
        advance(min(start + MATCH_CHUNK, len(pairs)))


def _unmatched(path: Path, names: Sequence[str], pairs: Sequence[tuple[int, int]], verify: bool) -> list[tuple[int, int]]:
    ids = image_ids(path, names)
    with pycolmap.Database.open(path) as database:

        def finished(a: int, b: int) -> bool:
            return database.exists_matches(a, b) and (not verify or database.exists_two_view_geometry(a, b))

        return [(a, b) for a, b in pairs if not finished(ids[a], ids[b])]


def _take(target: Path, source: Path) -> None:
    """Copies what was found in `source` to `target`."""
    database = sqlite3.connect(target)
    try:
        database.execute("ATTACH DATABASE ? AS share", (str(source),))
        with database:
            for table in RESULTS:
                database.execute(f"INSERT OR IGNORE INTO main.{table} SELECT * FROM share.{table}")
    finally:
        database.close()


def _remove(folder: Path) -> None:
    for file in folder.iterdir():
        file.unlink()
    folder.rmdir()
