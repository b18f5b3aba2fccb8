"""How many threads a process takes, which a batch says."""

import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from e4dgs.pipeline import Artifact, ArtifactWriter, files, thread_count
from e4dgs.pipeline.machine.threads import waiting_threads
from e4dgs.pipeline.storage import chunks


@pytest.mark.parametrize(("said", "threads", "waiting"), [("1", 1, 2), ("3", 3, 6), ("3,1", 3, 6), ("64", 64, 8)])
def test_what_is_said_counts(monkeypatch, said, threads, waiting):
    monkeypatch.setenv("OMP_NUM_THREADS", said)
    assert (thread_count(), thread_count(2), waiting_threads()) == (threads, min(2, threads), waiting)


@pytest.mark.parametrize("said", [None, "", "0", "many"])
def test_what_says_nothing_leaves_the_cores_of_this_process(monkeypatch, said):
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    if said is not None:
        monkeypatch.setenv("OMP_NUM_THREADS", said)
    assert thread_count() == len(os.sched_getaffinity(0))


@pytest.mark.parametrize("said", [1, 3])
def test_digests_syncs_and_chunks_keep_to_it(tmp_path, monkeypatch, said):
    """Writing, verifying and reading an artifact of several megabytes: every pool and every hasher, as they are made."""
    pools, hashers = [], []
    monkeypatch.setenv("OMP_NUM_THREADS", str(said))
    blake3 = files.blake3
    for module in (files, chunks):
        monkeypatch.setattr(module, "ThreadPoolExecutor", lambda most: pools.append(most) or ThreadPoolExecutor(most))
    monkeypatch.setattr(files, "blake3", lambda *data, **more: hashers.append(more.get("max_threads", 1)) or blake3(*data, **more))
    data = np.random.default_rng(0).random((5, 1 << 19))
    writer = ArtifactWriter(tmp_path / "a")
    writer.write("large", data)
    writer.finish({})
    artifact = Artifact(tmp_path / "a")
    artifact.verify()
    assert (artifact.read("large") == data).all()
    assert len(pools) >= 5 and set(pools) == {2 * said} and set(hashers) == {1, said}
