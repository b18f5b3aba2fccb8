"""The size that is usual on a device: taken where the user says nothing, told, and part of the settings."""

import pytest
from e4dgs.stages.captures import recognise
from e4dgs.stages.captures import usual as module
from e4dgs.stages.captures.usual import USUAL, Usual
from e4dgs.workflows.cli import main
from e4dgs.workflows.session import Choice, Options, open_session

SMALL = {"cpu": Usual(48, "a CPU"), "cuda": Usual(64, "a GPU")}


@pytest.fixture
def small(monkeypatch):
    """Limits that the small captures of the tests exceed."""
    from e4dgs.stages.frames import settings as frames

    monkeypatch.setattr(module, "USUAL", SMALL)
    monkeypatch.setattr(frames, "USUAL", SMALL)


def test_what_is_usual():
    assert (USUAL["cpu"].size, USUAL["cuda"].size) == (960, 1600)


def test_larger_pictures_are_limited_and_it_is_said(small, video_capture, tmp_path):
    session = open_session(Options(video_capture.root, tmp_path, Choice(device="cpu")))
    frames, facts = session.job.settings["frames"], session.job.capture.facts
    assert frames.max_size == 48 and max(facts["width"], facts["height"]) == 48
    assert "as is usual on a CPU; --set frames.max_size=" in " ".join(session.notes)


def test_what_is_asked_for_is_done_without_a_word(small, video_capture, tmp_path):
    given = ["frames.max_size=60"]
    session = open_session(Options(video_capture.root, tmp_path, Choice(set=given, device="cpu")))
    assert session.job.settings["frames"].max_size == 60
    assert max(session.job.capture.facts["width"], session.job.capture.facts["height"]) == 60
    assert not any("usual" in note for note in session.notes)


def test_smaller_captures_keep_their_settings_on_every_device(dnerf_capture, tmp_path):
    session = open_session(Options(dnerf_capture.root, tmp_path, Choice(device="cpu")))
    assert session.job.settings["frames"].max_size is None and not session.job.capture.chosen


def test_a_script_gets_the_capture_as_it_is(small, video_capture):
    assert recognise(video_capture.root).chosen == {}


def test_a_second_run_finds_the_first(small, dnerf_capture, tmp_path, capsys):
    words = [str(dnerf_capture.root), "--workspace", str(tmp_path), "--device", "cpu"]
    assert main(["run", "frames", *words]) == 0
    capsys.readouterr()
    assert main(["plan", *words]) == 0
    assert "nothing changed" in capsys.readouterr().out
