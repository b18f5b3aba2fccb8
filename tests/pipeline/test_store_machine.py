"""The store as a state machine: whatever happens in whatever order, opening a key gives what was published last or an error."""

import shutil
import tempfile
from pathlib import Path

import numpy as np
from e4dgs.pipeline import ArtifactError, Store
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

KEYS = st.sampled_from(["k1", "k2"])


class StoreMachine(RuleBasedStateMachine):
    @initialize()
    def begin(self):
        self.folder = Path(tempfile.mkdtemp())
        self.store = Store(self.folder / "store")
        self.model: dict[str, int | None] = {}  # key -> value; None: something lies there and is damaged

    def teardown(self):
        shutil.rmtree(self.folder, ignore_errors=True)

    @rule(key=KEYS, value=st.integers(0, 3))
    def publish(self, key, value):
        with self.store.lock("s", key), self.store.writing("s", key) as writer:
            writer.write("x", np.full(4, value))
            self.store.publish(writer, "s", key, {})
        self.model[key] = value

    @rule(key=KEYS)
    def stop_before_publishing(self, key):
        self.store.checkpoints("s", key).mkdir(parents=True, exist_ok=True)
        with self.store.lock("s", key), self.store.writing("s", key) as writer:
            writer.write("x", np.zeros(4))

    @rule(key=KEYS)
    def leave_a_dead_folder(self, key):
        folder = self.store.root / "tmp" / f"s-{key}-dead"
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "zarr.json").write_text("{")

    @rule(key=KEYS, file=st.sampled_from(["x/c/0", "x/zarr.json", "manifest.json", "info.json", "zarr.json"]))
    def lose_a_file(self, key, file):
        path = self.store.path("s", key) / file
        if path.exists():
            path.unlink()
            self.model[key] = None

    @rule(key=KEYS)
    def cut_a_file_short(self, key):
        path = self.store.path("s", key) / "x" / "c" / "0"
        if path.exists():
            path.write_bytes(path.read_bytes()[:3])
            self.model[key] = None

    @rule(key=KEYS)
    def remove(self, key):
        assert self.store.take("s", key, "tmp")
        self.model.pop(key, None)

    @rule()
    def sweep(self):
        self.store.sweep()
        assert not list((self.store.root / "tmp").glob("*"))

    @invariant()
    def keys_hold_what_was_published_last(self):
        if not hasattr(self, "model"):
            return
        assert {key for _, key in self.store.entries()} == set(self.model)
        for key in ("k1", "k2"):
            try:
                found = self.store.open("s", key).read("x").tolist()
            except ArtifactError:
                assert self.model.get(key) is None
            else:
                assert found == [self.model[key]] * 4


TestStore = StoreMachine.TestCase
TestStore.settings = settings(max_examples=15, stateful_step_count=12, deadline=None, derandomize=True, database=None)
