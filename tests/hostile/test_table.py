"""Hundreds of captures that nobody should give: each is accepted or refused in one line, within ten seconds and two gigabytes."""

import itertools
import json
import queue
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from e4dgs.pipeline.errors import LONGEST, CaptureError

from .captures import put, write
from .referee import BrokenRule, examine
from .table import CASES

SILENCE = 300.0  # s without a line, of a machine that may be busy


def test_there_are_hundreds_of_every_kind():
    assert len(CASES) > 500
    assert all(sum(case.layout.startswith(layout) for case in CASES.values()) >= 10 for layout in ("dnerf", "n3v", "nerfies", "colmap"))


@pytest.mark.timeout(1800)  # on an idle core it takes 30 s; what hangs is found by its silence
def test_no_capture_of_the_table_does_harm():
    """In a process of its own, which may have so much memory, and whose death says which capture it was."""
    command = [sys.executable, str(Path(__file__).with_name("run_table.py"))]
    said: list[str] = []
    lines: queue.SimpleQueue[str] = queue.SimpleQueue()
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as process:
        assert process.stdout is not None
        reader = threading.Thread(target=lambda: [lines.put(line) for line in itertools.chain(process.stdout, [""])], daemon=True)
        reader.start()
        try:
            while line := lines.get(timeout=SILENCE):
                said.append(line.rstrip())
        except queue.Empty:
            process.kill()
            pytest.fail(f"it hangs: {said[-1:]}")
    assert process.returncode == 0, "\n".join([line for line in said if "BROKEN" in line] or said[-20:])
    assert said[-1] == f"{len(CASES)} cases, 0 broke a rule"


def capture_of(words: list[str]) -> Path:
    return Path(words[words.index("--workspace") - 1])


def workspace_of(words: list[str]) -> Path:
    return Path(words[words.index("--workspace") + 1])


@pytest.mark.parametrize(
    ("deed", "words"),
    [
        (lambda words: 1, "ended with 1"),
        (lambda words: print("error: a\nb", file=sys.stderr) or 2, "no single line"),
        (lambda words: print("error: \x1b[2J", file=sys.stderr) or 2, "control characters"),
        (lambda words: print("\udcff") or 0, "surrogates not allowed"),
        (lambda words: put(capture_of(words), "0.png", b""), "outside of the workspace"),
        (lambda words: put(capture_of(words), "new.txt", b""), "outside of the workspace"),
        (lambda words: put(workspace_of(words), "store/frames/0123/zarr.json", b""), "no whole result"),
        (lambda words: put(workspace_of(words), "store/tmp/0123/zarr.json", b""), "left behind"),
        (lambda words: put(workspace_of(words), "unpacked/.0123/a.png", b""), "left behind"),
        (lambda words: signal.raise_signal(signal.SIGPROF) or 0, "s of CPU"),
    ],
)
def test_the_referee_sees_what_it_is_for(tmp_path, deed, words):
    with pytest.raises((BrokenRule, UnicodeEncodeError), match=words):
        examine(tmp_path, write("images", tmp_path / "capture"), command=lambda given: deed(given) or 0)


def test_the_referee_misses_the_name_of_what_is_damaged(tmp_path):
    def refused(words):
        print("error: 1.png: not a readable image", file=sys.stderr)
        return 2

    assert "1.png" in examine(tmp_path, write("images", tmp_path / "capture"), command=refused, names=("1.png",))
    with pytest.raises(BrokenRule, match=r"'file_path' is not named in: error: 1\.png"):
        examine(tmp_path, tmp_path / "capture", command=refused, names=("1.png", "file_path"))


def test_messages_are_one_printable_line_however_names_are():
    message = str(CaptureError("a\nb\x1b[2J\udcff\u202e" + "x" * 10_000 + "; do this"))
    assert message.startswith(r"a\nb\x1b[2J\udcff\u202exx") and message.endswith("; do this") and len(message) < LONGEST + 50
    json.dumps(message).encode()
