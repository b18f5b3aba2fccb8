"""Garbage is collected beside runs: what is live, pinned, in use or being built stays, whatever crashes in between."""

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pytest
from e4dgs.pipeline import ArtifactError, Pins, Runner, SettingsError, Store, collect, make_plan, unused
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

DAY = 86400.0


def put(store: Store, key: str, value: float = 1.0, kilobytes: int = 1) -> None:
    with store.lock("s", key), store.writing("s", key) as writer:
        writer.write("x", np.random.default_rng(0).random((kilobytes, 128)) + value)
        store.publish(writer, "s", key, {})


def age(store: Store, key: str, days: float) -> None:
    then = time.time() - days * DAY
    os.utime(store.path("s", key) / "manifest.json", (then, then))


def keys(store: Store) -> list[str]:
    return [key for _, key in store.entries()]


class Crash(BaseException):
    """The process ends here."""


@contextlib.contextmanager
def dying_at(n: int):
    """The nth rename or removal, and everything after it, is not done any more."""
    left = [n]

    def wrap(original):
        def call(*args, **kwargs):
            left[0] -= 1
            if left[0] <= 0:
                raise Crash
            return original(*args, **kwargs)

        return call

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "rename", wrap(os.rename))
        patch.setattr(shutil, "rmtree", wrap(shutil.rmtree))
        yield lambda: left[0] <= 0


def none() -> set[tuple[str, str]]:
    return set()


@pytest.fixture
def store(tmp_path) -> Store:
    """Results a (used 30 days ago), b (20) and c (10)."""
    store = Store(tmp_path / "store")
    for key, days in (("a", 30), ("b", 20), ("c", 10)):
        put(store, key)
        age(store, key, days)
    return store


def test_without_limits_all_goes_that_is_not_live(store):
    chosen, total = unused(store, lambda: {("s", "b")})
    assert [item.name for item in chosen] == ["s/a", "s/c"] and total == 3 * chosen[0].size
    found = collect(store, lambda: {("s", "b")})
    assert found.removed == chosen and found.left == chosen[0].size and keys(store) == ["b"]
    store.open("s", "b").verify()


def test_an_age_spares_what_was_used_since(store):
    collect(store, none, older_than=15 * DAY)
    assert keys(store) == ["c"]


def test_a_size_takes_what_was_used_longest_ago_and_no_more_than_it_must(store):
    size = unused(store, none)[0][0].size
    assert collect(store, none, keep_bytes=3 * size).removed == []
    assert [item.key for item in collect(store, lambda: {("s", "a")}, keep_bytes=2 * size).removed] == ["b"]
    found = collect(store, lambda: {("s", "a")}, keep_bytes=0)
    assert keys(store) == ["a"] and found.left == size, "a live result stays though it is too much"


def test_a_clock_that_was_wrong_costs_nothing(store):
    age(store, "a", -400)  # used in the future
    collect(store, none, older_than=15 * DAY)
    assert keys(store) == ["a", "c"]


def test_a_run_that_reuses_a_result_makes_it_young(bench):
    key = Runner(bench.job()).run()[0].artifact.path.name
    manifest = bench.store.path("numbers", key) / "manifest.json"
    os.utime(manifest, (1, 1))
    make_plan(bench.job())
    assert manifest.stat().st_mtime == 1, "a plan changes nothing"
    bench.run()
    assert time.time() - manifest.stat().st_mtime < 60


def test_pins_keep_what_they_name_until_they_are_taken_back(store):
    pins = Pins(store)
    assert pins.add("mine", [("s", "a")]) == [("s", "a")]
    assert pins.add("mine", [("s", "c"), ("s", "a")]) == [("s", "a"), ("s", "c")]
    pins.add("other", [("s", "a")])
    assert pins.results() == {("s", "a"): ["mine", "other"], ("s", "c"): ["mine"]}
    collect(store, none)
    assert keys(store) == ["a", "c"]
    assert pins.remove("mine") and not pins.remove("mine")
    collect(store, none)
    assert keys(store) == ["a"]
    with pytest.raises(ArtifactError, match="s/b is not there"):
        pins.add("other", [("s", "b")])
    assert pins.read("other") == [("s", "a")]
    with pytest.raises(SettingsError, match="letters"):
        pins.add("../up", [("s", "a")])
    (store.root / "pins" / "other.json").write_text("[]")
    with pytest.raises(ArtifactError, match=r"other\.json: this is not a list"):
        collect(store, none)
    assert keys(store) == ["a"], "a pin that cannot be read is no reason to remove"


def test_what_is_open_or_being_built_is_left_and_said(store):
    artifact = store.open("s", "a")
    with store.lock("s", "b"):
        found = collect(store, none)
    assert [item.key for item in found.busy] == ["a", "b"] and [item.key for item in found.removed] == ["c"]
    assert artifact.read("x").shape == (1, 128)
    del artifact
    collect(store, none)
    assert keys(store) == []


def test_a_result_that_a_run_takes_up_meanwhile_is_put_back(store):
    """Between the look at what is live and the removal a whole run may have begun and ended."""
    asked = iter([set(), {("s", "b")}])
    found = collect(store, lambda: next(asked))
    assert [item.key for item in found.busy] == ["b"] and keys(store) == ["b"]
    store.open("s", "b").verify()


@pytest.mark.parametrize("needed", [set(), {("s", "a")}], ids=["unused", "taken up"])
def test_a_result_that_is_gone_already_ends_no_collection(store, needed):
    """Somebody removes the folder by hand between the look at what there is and the removal."""

    def live():
        shutil.rmtree(store.path("s", "a"), ignore_errors=True)
        return asked.pop(0)

    asked = [set(), needed]
    collect(store, live)
    assert keys(store) == [] and not list((store.root / "trash").iterdir()), "what was taken is left in the trash"


def test_remains_of_damage_and_of_dead_runs_go_and_checkpoints_when_they_are_old(store):
    place = store.quarantine("s", "a")
    (store.root / "tmp" / "s-b-dead").mkdir()
    for key in ("old", "new", "busy"):
        store.checkpoints("s", key).mkdir(parents=True)
        (store.checkpoints("s", key) / "state").touch()
    for key in ("old", "busy"):
        for path in (store.checkpoints("s", key) / "state", store.checkpoints("s", key)):
            os.utime(path, (1, 1))
    with store.lock("s", "busy"):
        names = [item.name for item in collect(store, none, older_than=25 * DAY).removed]
    assert names == ["tmp/s-b-dead", "checkpoints/s-old"] and place.is_dir(), "a new quarantine is not old"
    names = [item.name for item in collect(store, lambda: {("s", "b"), ("s", "c")}).removed]
    assert names == [f"quarantine/{place.name}"]
    assert {path.name for path in (store.root / "checkpoints").iterdir()} == {"s-new", "s-busy"}


def test_a_process_that_uses_a_result_keeps_it_until_it_is_killed(store):
    code = (
        "import sys, time\nfrom pathlib import Path\nfrom e4dgs.pipeline import Store\n"
        "held = Store(Path(sys.argv[1])).open('s', 'a')\nprint('held', flush=True)\ntime.sleep(60)\n"
    )
    process = subprocess.Popen([sys.executable, "-c", code, str(store.root)], stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "held\n"
    collect(store, none)
    assert keys(store) == ["a"]
    process.send_signal(signal.SIGKILL)
    process.wait()
    collect(store, none)
    assert keys(store) == []


def test_collecting_beside_runs_costs_no_run(bench):
    """A run of other settings each time, while everything that is nobody's is collected as fast as it goes."""
    code = (
        "import sys\nfrom pathlib import Path\nsys.path.insert(0, sys.argv[1])\nimport toy_stages\nfrom e4dgs.pipeline import collect\n"
        "store = toy_stages.Bench(Path(sys.argv[2])).store\nprint('begun', flush=True)\n"
        "while not (Path(sys.argv[2]) / 'enough').exists():\n    collect(store, set)\n"
    )
    words = [sys.executable, "-c", code, str(Path(__file__).parent), str(bench.root)]
    collector = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert collector.stdout.readline() == "begun\n"
    for k in range(12):
        outcomes = Runner(bench.job(clipped__limit=k % 3)).run()
        assert outcomes[3].artifact.attrs["total"] == sum(min(value, k % 3) for value in (1, 2, 3))
        for outcome in outcomes:
            outcome.artifact.verify()
    (bench.root / "enough").touch()
    assert collector.wait(timeout=30) == 0, collector.stderr.read()


def test_a_collection_that_dies_loses_nothing_that_a_run_took_up(store):
    for n in range(1, 20):
        for key in ("a", "b", "c"):
            if not store.has("s", key):
                put(store, key)
        asked = iter([set(), {("s", "b")}])
        with dying_at(n) as died, contextlib.suppress(Crash):
            collect(store, lambda: next(asked))  # noqa: B023
        collect(store, lambda: {("s", "b")})
        assert keys(store) == ["b"], n
        store.open("s", "b").verify()
        assert not list((store.root / "trash").iterdir())
        if not died():
            break
    assert n > 5, "it must have died at many places"


class CollectMachine(RuleBasedStateMachine):
    """``live`` is what scenes' records say; runs hold what they use until they end, and only then their records count."""

    KEYS = st.sampled_from(["a", "b", "c", "d"])

    @initialize()
    def begin(self):
        self.folder = Path(tempfile.mkdtemp(dir="/dev/shm" if os.access("/dev/shm", os.W_OK) else None))  # it syncs thousands of times
        self.store = Store(self.folder / "store")
        self.there: dict[str, int] = {}  # what must be there, as it was published; garbage may or may not be
        self.live: set[str] = set()
        self.runs: dict[int, tuple[str, object]] = {}
        self.locks: dict[str, contextlib.ExitStack] = {}
        self.count = 0

    def teardown(self):
        for lock in self.locks.values():
            lock.close()
        self.runs.clear()
        shutil.rmtree(self.folder, ignore_errors=True)

    @rule(key=KEYS)
    def publish(self, key):
        if key not in self.locks and key not in self.held() and not self.store.has("s", key):
            self.count += 1
            put(self.store, key, self.count)
            self.there[key] = self.count

    @rule(key=KEYS)
    def begin_a_run(self, key):
        if self.store.has("s", key):
            self.runs[self.count] = key, self.store.open("s", key)
            self.count += 1

    @rule(recorded=st.booleans())
    def end_a_run(self, recorded):
        """``recorded``: it ended well; else it was killed."""
        if self.runs:
            key, _ = self.runs.pop(min(self.runs))
            if recorded:
                self.live.add(key)

    @rule(key=KEYS)
    def begin_or_end_building(self, key):
        if key in self.locks:
            self.locks.pop(key).close()
        else:
            self.locks[key] = contextlib.ExitStack()
            self.locks[key].enter_context(self.store.lock("s", key))

    @rule(key=KEYS)
    def a_builder_dies(self, key):
        """What it has written stays in ``tmp``, and its checkpoint; the system has freed its lock."""
        (self.store.root / "tmp" / f"s-{key}-dead").mkdir(parents=True, exist_ok=True)
        self.store.checkpoints("s", key).mkdir(parents=True, exist_ok=True)

    @rule(key=KEYS)
    def damage_and_set_aside(self, key):
        """Whoever finds damage moves it to the quarantine, though others have the result open."""
        if self.store.has("s", key) and key not in self.locks:
            chunk = self.store.path("s", key) / "x/c/0/0"
            chunk.write_bytes(chunk.read_bytes()[:-1])
            assert self.store.quarantine_damaged("s", key) is not None
            self.there.pop(key, None)

    @rule(key=KEYS)
    def forget_a_scene(self, key):
        self.live.discard(key)

    @rule(key=KEYS)
    def pin(self, key):
        if self.store.has("s", key):
            Pins(self.store).add(f"pin-{key}", [("s", key)])

    @rule(key=KEYS)
    def unpin(self, key):
        Pins(self.store).remove(f"pin-{key}")

    @rule(keep=st.sampled_from([None, 0, 5000]), older=st.sampled_from([None, DAY]), dies=st.sampled_from([0, 0, 1, 2, 3]), taken_up=KEYS)
    def collect(self, keep, older, dies, taken_up):
        """In the midst of it a run takes up a result, uses it, and ends; perhaps the collection dies."""
        asked = 0

        def live():
            nonlocal asked
            asked += 1
            answer = {("s", key) for key in self.live}
            if asked == 1 and self.store.has("s", taken_up):
                self.store.open("s", taken_up)
                self.live.add(taken_up)
            return answer

        kept, there = self.kept(), {*self.there}
        if not dies:
            found = collect(self.store, live, keep, older)
            gone = {item.key for item in found.removed if item.key}
            assert not gone & (kept | self.live)
            dead = {path.name for path in (self.store.root / "tmp").glob("s-*-dead")}
            assert dead <= {f"s-{key}-dead" for key in self.locks}, "only beside what is being built"
        else:
            with dying_at(dies), contextlib.suppress(Crash):
                collect(self.store, live, keep, older)
            # Only what was taken up just now may be away, until the next collection has put it back.
            collect(self.store, lambda: {("s", key) for key in self.there}, None, None)
        self.there = {key: value for key, value in self.there.items() if self.store.has("s", key)}
        assert kept | (self.live & {taken_up} & there) <= self.there.keys()

    def held(self) -> set[str]:
        return {key for key, _ in self.runs.values()}

    def kept(self) -> set[str]:
        pinned = {key for _, key in Pins(self.store).results()}
        return (self.live | self.held() | pinned | self.locks.keys()) & self.there.keys()

    @invariant()
    def what_must_be_there_is_whole(self):
        if hasattr(self, "there"):
            for key, value in self.there.items():
                assert 0 <= self.store.open("s", key).read("x").min() - value < 1, key


TestCollect = CollectMachine.TestCase
TestCollect.settings = settings(max_examples=100, stateful_step_count=32, deadline=None, derandomize=True, database=None)
