"""A request to end is heard wherever it arrives."""

import signal
import subprocess
import sys
import textwrap

import pytest
from e4dgs.workflows.machine.interrupts import said_when_interrupted

PROGRAM = """
    import os, signal, sys, time, weakref
    from e4dgs.workflows.machine.interrupts import end_cleanly_when_terminated

    class Owner:
        def __del__(self):
            if where == "del":
                os.kill(os.getpid(), number)

    where, number = sys.argv[1], int(sys.argv[2])
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs ignore it
    end_cleanly_when_terminated()
    end_cleanly_when_terminated()
    owner = Owner()
    gone = weakref.ref(owner, lambda _: os.kill(os.getpid(), number)) if where == "weakref" else None
    try:
        del owner
        print("dropped", flush=True)
        time.sleep(30)
    except KeyboardInterrupt:
        sys.exit(7)
"""


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
@pytest.mark.parametrize("where", ["weakref", "del"])
def test_an_interrupt_that_python_drops_comes_again(where, number):
    words = [sys.executable, "-c", textwrap.dedent(PROGRAM), where, str(int(number))]
    done = subprocess.run(words, capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (7, "dropped\n", "")


def test_what_else_is_dropped_is_still_told():
    program = """
        from e4dgs.workflows.machine.interrupts import end_cleanly_when_terminated

        class Owner:
            def __del__(self):
                raise OSError("no room")

        end_cleanly_when_terminated()
        Owner()
        print("on")
    """
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(program)], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0 and done.stdout == "on\n" and "no room" in done.stderr


LOSES = """
    import os, signal, sys, time
    from e4dgs.workflows.machine import interrupts

    interrupts.PATIENCE = 0.2
    interrupts.end_cleanly_when_terminated()
    try:
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(1)
    except KeyboardInterrupt:
        print("lost", flush=True)
    if sys.argv[1] == "ended":
        interrupts.ended()
    try:
        time.sleep(1)
        print("on")
    except KeyboardInterrupt:
        interrupts.ended()
        print("heard")
    time.sleep(0.5)
"""


@pytest.mark.parametrize(("command", "then"), [("goes on", "heard"), ("ended", "on")])
def test_a_sigterm_that_a_library_loses_comes_again_until_the_command_ends(command, then):
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(LOSES), command], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (0, f"lost\n{then}\n", "")


def test_checkpoints_are_promised_of_commands_that_have_them_alone():
    for words in (["run", "all", "a"], ["batch", "a"], ["bench", "pipeline", "a"]):
        assert said_when_interrupted(words).endswith("a long stage continues from its last checkpoint")
    for words in (["render", "run", "--out", "a.mp4"], ["export", "ply", "a"]):
        assert said_when_interrupted(words) == "interrupted; give the command again: it begins anew"
    assert said_when_interrupted(["store", "gc"]) == said_when_interrupted([]) == "interrupted"
