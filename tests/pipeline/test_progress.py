"""Progress: nothing for quick loops, a line now and then where there is no terminal; peak memory belongs to its stage."""

import io
import mmap
import time

import numpy as np
import pytest
from e4dgs.pipeline import Progress, counted, duration
from e4dgs.pipeline.machine import memory
from e4dgs.pipeline.machine.memory import PeakMemory
from e4dgs.pipeline.running import progress as module
from rich.console import Console


def run_for(monkeypatch, seconds_a_step: float, terminal: bool = False) -> str:
    clock = iter(np.arange(0, 1000, seconds_a_step))
    monkeypatch.setattr(module.time, "monotonic", lambda: float(next(clock)))
    out = io.StringIO()
    with Progress(40, "coarse", Console(file=out, force_terminal=terminal, width=200)) as bar:
        for _ in range(40):
            bar.advance(note="loss 0.5")
    monkeypatch.undo()
    return out.getvalue()


def test_a_quick_loop_says_nothing(monkeypatch):
    assert run_for(monkeypatch, 0.01) == ""


def test_a_long_loop_says_a_line_every_ten_seconds(monkeypatch):
    lines = run_for(monkeypatch, 1.0).splitlines()
    assert lines[0] == "  coarse: 10/40 (25 %), 30 s left, loss 0.5"
    assert len(lines) == 4


def at(monkeypatch, bar: Progress, seconds: float, units: int) -> float:
    """Advances by units at a time, and returns the seconds that are said to be left."""
    monkeypatch.setattr(module.time, "monotonic", lambda: seconds)
    bar.advance(units)
    return bar._left()


def test_the_time_left_knows_of_units_that_take_longer(monkeypatch):
    monkeypatch.setattr(module.time, "monotonic", lambda: 0.0)
    bar = Progress(200, "coarse")
    bar.weigh([(100, 1.0), (100, 4.0)])
    assert at(monkeypatch, bar, 25.0, 50) == pytest.approx(0.5 * 50 + 0.5 * 400)
    assert at(monkeypatch, bar, 50.0, 50) == pytest.approx(0.5 * 400)
    assert at(monkeypatch, bar, 150.0, 50) == pytest.approx(100.0)


def test_what_an_earlier_run_has_done_took_no_time_in_this_one(monkeypatch):
    monkeypatch.setattr(module.time, "monotonic", lambda: 0.0)
    bar = Progress(100, "coarse")
    at(monkeypatch, bar, 1.0, 60)
    assert at(monkeypatch, bar, 11.0, 10) == pytest.approx(30.0)


def test_the_time_left_follows_the_speed_of_the_last_minute(monkeypatch):
    monkeypatch.setattr(module.time, "monotonic", lambda: 0.0)
    bar = Progress(1000, "coarse")
    for second in range(1, 101):
        at(monkeypatch, bar, second, 5)
    for second in range(101, 161):
        left = at(monkeypatch, bar, second, 1)
    assert left == pytest.approx(1000 - 560, rel=0.02)


def test_counts_read_well():
    assert [counted(n, "camera") for n in (0, 1, 2)] == ["0 cameras", "1 camera", "2 cameras"]
    assert [counted(n, "convex", "convexes") for n in (1, 45)] == ["1 convex", "45 convexes"]


def test_durations_read_well():
    assert [duration(s) for s in (0.4213, 9.7, 12.3, 185, 7800)] == ["0.42 s", "9.7 s", "12 s", "3 min 05 s", "2 h 10 min"]


@pytest.mark.parametrize("ignored", [False, True], ids=["reset", "reset-ignored"])
def test_peak_memory_is_that_of_the_block_alone(monkeypatch, ignored):
    if ignored:  # a kernel whose mark is that of the whole life of the process, whatever is written
        monkeypatch.setattr(memory, "_reset_mark", lambda: True)
    # From the kernel itself: malloc may serve a block from memory that earlier tests freed and that is still resident.
    with PeakMemory() as first, mmap.mmap(-1, 320_000_000, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS) as block:
        block[:: mmap.PAGESIZE] = bytes(len(range(0, len(block), mmap.PAGESIZE)))  # touched
        time.sleep(0.5)  # ten samples: not every kernel keeps a high-water mark
    with PeakMemory() as second:
        pass
    assert first.mb > second.mb + 250


@pytest.mark.parametrize("width", [40, 60, 80])
@pytest.mark.parametrize(("total", "label"), [(4000, "coarse"), (30_000, "coarse: first motion of everything that moves")])
def test_a_narrow_terminal_keeps_the_percentage_and_the_time_left(monkeypatch, width, total, label):
    now = [0.0]
    monkeypatch.setattr(module.time, "monotonic", lambda: now[0])
    shown = io.StringIO()
    with Progress(total, label, Console(file=io.StringIO(), force_terminal=True, width=width)) as bar:
        for _ in range(30):
            now[0] += 3.0
            bar.advance(total // 40, note="deformation, loss 0.1225, 12345 Gaussians, 0 convexes")
        Console(file=shown, width=width).print(bar._bar.get_renderable())
    (line,) = shown.getvalue().splitlines()
    assert len(line) <= width and " 75% " in line and f" {total * 3 // 4}/{total} " in line, line
    assert any(part.count(":") == 2 for part in line.split()), "the time left"
    assert "…" in line, "what is cut has a mark"


def test_a_dumb_terminal_gets_lines():
    out = io.StringIO()
    with Progress(2, "coarse", Console(file=out, force_terminal=True, width=100, _environ={"TERM": "dumb"}), line_seconds=0.0) as bar:
        bar._start -= 10.0
        bar.advance()
    assert out.getvalue().startswith("  coarse: 1/2 (50 %)") and "\x1b" not in out.getvalue()
