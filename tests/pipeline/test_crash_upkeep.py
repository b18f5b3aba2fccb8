"""Pins, collections and `verify` fail or die at any call: what must stay is whole, what was asked for is done by the next one."""

import contextlib
import errno
import os

import numpy as np
import pytest
from e4dgs.pipeline import ArtifactError, Pins, Store, collect
from failing import Crash, FailNth

ERRORS = pytest.mark.parametrize("error", [OSError(errno.ENOSPC, "No space left on device"), Crash()], ids=["error", "crash"])


@pytest.fixture
def store(quick_folder) -> Store:
    return Store(quick_folder / "store")


def put(store: Store, *keys: str) -> None:
    for age, key in enumerate(keys):
        if not store.has("s", key):
            with store.lock("s", key), store.writing("s", key) as writer:
                writer.write("x", np.full(100, age))
                store.publish(writer, "s", key, {})
        os.utime(store.path("s", key) / "manifest.json", (age, age))


def failing(store: Store, error: BaseException, most: int = 200):
    """Counts n up until nothing fails any more; the caller does its work inside what each turn gives."""
    for n in range(1, most):
        attempt = FailNth(n, error, store.root)

        @contextlib.contextmanager
        def turn(attempt=attempt):
            with attempt.patched(), contextlib.suppress(OSError, Crash, ArtifactError):
                yield

        yield turn
        if not attempt.failed:
            assert n > 3, "it must have failed at several places"
            return
    raise AssertionError("it never got through")


def keys(store: Store) -> list[str]:
    return [key for _, key in store.entries()]


@ERRORS
@pytest.mark.parametrize("before", [[], [("s", "a")]], ids=["new", "more"])
def test_a_pin_is_there_as_a_whole_or_as_before(store, error, before):
    put(store, "a", "b")
    for turn in failing(store, error):
        Pins(store).remove("mine")
        if before:
            Pins(store).add("mine", before)
        with turn():
            Pins(store).add("mine", [("s", "b")])
        assert Pins(store).read("mine") in (before, [*before, ("s", "b")])
        assert Pins(store).names() in ([], ["mine"]) and not any(name.startswith(".") for name in Pins(store).names())
        kept = [key for _, key in Pins(store).read("mine")]
        collect(store, lambda: {("s", "a"), ("s", "b")})
        assert keys(store) == ["a", "b"] and set(kept) <= {"a", "b"}


@ERRORS
def test_a_pin_that_is_taken_back_is_gone_or_there(store, error):
    put(store, "a")
    for n in range(1, 3):
        Pins(store).add("mine", [("s", "a")])
        with FailNth(n, error, store.root).patched(), contextlib.suppress(OSError, Crash):
            Pins(store).remove("mine")
        assert Pins(store).results() in ({}, {("s", "a"): ["mine"]})


@ERRORS
@pytest.mark.parametrize("limits", [{}, {"keep_bytes": 0}, {"older_than": 86400.0}], ids=["all", "size", "age"])
def test_a_collection_leaves_whole_results_and_the_next_one_finishes_it(store, error, limits):
    """Of a, b, c and d, b is live, c is pinned, and d is live only when it is asked the second time."""
    for turn in failing(store, error):
        put(store, "a", "b", "c", "d")
        Pins(store).add("mine", [("s", "c")])
        (store.root / "tmp" / "s-a-dead").mkdir(parents=True, exist_ok=True)
        asked = iter([{("s", "b")}])
        with turn():
            collect(store, lambda: next(asked, {("s", "b"), ("s", "d")}), **limits)  # noqa: B023
        assert {"b", "c"} <= set(keys(store))
        assert not any(problem for _, _, problem in store.verify())
        collect(store, lambda: {("s", "b"), ("s", "d")}, **limits)
        assert keys(store) == ["b", "c", "d"]
        assert not any(problem for _, _, problem in store.verify()), "what was put back is whole"
        assert not list((store.root / "trash").iterdir()) and not list((store.root / "tmp").iterdir())


@ERRORS
def test_damage_that_verify_sets_aside_lies_in_one_place(store, error):
    for turn in failing(store, error, most=20):
        put(store, "a")
        chunk = store.path("s", "a") / "x/c/0"
        chunk.write_bytes(chunk.read_bytes()[:-1] + b"?")
        with turn():
            store.quarantine_damaged("s", "a")
        places = [*(store.root / "quarantine").glob("*"), *([store.path("s", "a")] if store.has("s", "a") else [])]
        assert len(places) == 1 and len([*places[0].rglob("*")]) == 7, "whole, here or there"
        store.quarantine_damaged("s", "a")
        assert not store.has("s", "a")
        collect(store, set)
        assert not list((store.root / "quarantine").iterdir())


@ERRORS
@pytest.mark.parametrize("limits", [{"older_than": 86400.0}, {"older_than": 86400.0, "keep_bytes": 0}], ids=["age", "size"])
def test_old_checkpoints_and_quarantine_go_as_a_whole(store, error, limits):
    """Half of a checkpoint that lies there is worse than none: a run would go on from it."""
    names = {f"part{k}" for k in range(3)}
    for turn in failing(store, error):
        put(store, "live")
        folders = {"old": store.checkpoints("s", "old"), "new": store.checkpoints("s", "new")}
        folders["aside"] = store.root / "quarantine" / "s-a-20200101T000000Z-abcd"
        for which, folder in folders.items():
            (folder / "inner").mkdir(parents=True, exist_ok=True)
            for path in (*(folder / "inner" / name for name in names), folder / "inner", folder):
                path.touch()
                os.utime(path, None if which == "new" else (0, 0))
        with turn():
            collect(store, lambda: {("s", "live")}, **limits)
        for folder in folders.values():
            assert not folder.exists() or {path.name for path in (folder / "inner").iterdir()} == names
        assert folders["new"].exists() and keys(store) == ["live"]
        collect(store, lambda: {("s", "live")}, **limits)
        assert [folder.exists() for folder in folders.values()] == [False, True, False]
        assert not list((store.root / "tmp").iterdir())


@ERRORS
def test_checkpoints_are_dropped_as_a_whole(store, error):
    for turn in failing(store, error):
        put(store, "a")
        folder = store.checkpoints("s", "a")
        folder.mkdir(parents=True, exist_ok=True)
        for name in ("weights", "state"):
            (folder / name).write_text("of one step")
        with turn(), store.lock("s", "a"):
            store.drop_checkpoints("s", "a")
        assert not folder.exists() or len(list(folder.iterdir())) == 2
