"""What is shown of a batch, in a terminal and in a log."""

import io
import re

from e4dgs.workflows.batch import board
from e4dgs.workflows.batch.board import States, how_far
from e4dgs.workflows.batch.ledger import Ledger, SceneState
from e4dgs.workflows.batch.listing import Entry
from rich.console import Console


def test_how_far_a_stage_is_comes_from_the_last_line_of_its_log(tmp_path):
    log = tmp_path / "scene.log"
    assert how_far(log) == ""
    log.write_text("== frames\nframes: 10/10 (100 %), 0 s left\n== coarse\n")
    assert how_far(log) == "", "of the stage that runs, not of the one before"
    log.write_text(log.read_text() + "  coarse: 5/10 (50 %), 2 min 03 s left, loss\n  coarse: 6/10 (60 %), 1 min 50 s left, loss\n")
    assert how_far(log) == "60 %, 1 min 50 s left"


def test_looking_at_a_batch_again_reads_no_scene_that_is_done(tmp_path):
    ledger = Ledger.create(tmp_path, "many", [Entry(f"scene{k}", "/capture") for k in range(50)])
    for k in range(49):
        ledger.write(f"scene{k}", SceneState("done"))
    states = States(ledger)
    assert [progress.state for _, progress in states.now()] == ["done"] * 49 + ["waiting"]
    (ledger.folder / "batch.json").unlink()
    for k in range(49):
        (ledger.folder / "states" / f"scene{k}.json").unlink()
    ledger.write("scene49", SceneState("failed", "coarse"))
    assert [progress.state for _, progress in states.now()] == ["done"] * 49 + ["failed"]


def test_a_log_says_every_change_and_now_and_then_how_far_the_batch_is(tmp_path, monkeypatch):
    monkeypatch.setattr(board, "EVERY", 0.0)
    monkeypatch.setattr(board, "EVERY_LINE", 0.0)
    ledger = Ledger.create(tmp_path, "night", [Entry(name, "/capture") for name in ("a", "b", "c")])
    ledger.log("b").parent.mkdir(parents=True)
    ledger.log("b").write_text("== coarse\n  coarse: 6/10 (60 %), 1 min 50 s left, loss\n")
    looks = 0

    def ended() -> bool:
        nonlocal looks
        looks += 1
        if looks == 2:
            ledger.write("a", SceneState("failed", "flow", "no two pictures"))
        return looks == 3

    out = io.StringIO()
    with ledger.at_work("b", lambda: False):
        ledger.write("b", SceneState("running", "coarse"))
        board.watch(ledger, Console(file=out, width=200), ended)
    said = out.getvalue().splitlines()
    assert said[0] == "b: running coarse" and said[2] == "a: failed flow: no two pictures"
    assert said[1] == "night: 1 running, 2 waiting | b coarse 60 %, 1 min 50 s left", "nothing has come to its end, so nobody knows"
    assert re.fullmatch(r"night: 1 running, 1 failed, 1 waiting; about \S+ s left \| b coarse 60 %, 1 min 50 s left", said[3])
    assert len(said) == 4


def test_a_terminal_sees_the_table_with_what_runs_first(tmp_path, monkeypatch):
    monkeypatch.setattr(board, "EVERY", 0.0)
    ledger = Ledger.create(tmp_path, "night", [Entry(name, "/capture") for name in ("a", "b")])
    ledger.log("b").parent.mkdir(parents=True)
    ledger.log("b").write_text("== coarse\n  coarse: 6/10 (60 %), 1 min 50 s left, loss\n")
    out = io.StringIO()
    with ledger.at_work("b", lambda: False):
        ledger.write("b", SceneState("running", "coarse"))
        board.watch(ledger, Console(file=out, width=120, force_terminal=True, color_system=None), lambda: True)
    rows = [line.split() for line in out.getvalue().splitlines()]
    assert ["b", "running", "coarse"] in [row[:3] for row in rows] and ["a", "waiting"] in rows
    assert "60 %, 1 min 50 s left" in out.getvalue()


def test_a_dumb_terminal_gets_lines_in_place_of_a_table_that_it_cannot_draw(tmp_path, monkeypatch):
    monkeypatch.setattr(board, "EVERY", 0.0)
    ledger = Ledger.create(tmp_path, "night", [Entry("a", "/capture")])
    ledger.write("a", SceneState("failed", "coarse", "no memory"))
    out = io.StringIO()
    board.watch(ledger, Console(file=out, width=120, force_terminal=True, _environ={"TERM": "dumb"}), lambda: True)
    assert out.getvalue() == "a: failed coarse: no memory\n"


def test_a_scene_whose_worker_is_gone_is_shown_as_lost(tmp_path):
    ledger = Ledger.create(tmp_path, "night", [Entry("a", "/capture")])
    with ledger.at_work("a", lambda: False) as ours:
        ledger.write("a", SceneState("running", "coarse"))
        assert ours and ledger.shown("a").state == "running"
        stopped = iter([False, True])
        with ledger.at_work("a", lambda: next(stopped)) as theirs:
            assert not theirs, "one at a time"
    assert ledger.shown("a").state == "lost" and "e4dgs batch" in ledger.shown("a").message
    ledger.write("a", SceneState("waiting"))
    assert ledger.shown("a").state == "waiting"
