#!/usr/bin/env python
"""Gives the captures of the table to e4dgs, one after the other in this process, with a limit on its memory.

    python tests/hostile/run_table.py                 all of them; what broke a rule, and how
    python tests/hostile/run_table.py "archive: "     those in whose name this expression is found, and what was said to each
    python tests/hostile/run_table.py --share 0/2     every second one

Prints a line before a case begins and one when it is done, so that a process that dies names the case that killed it. Exit code 1 where
a rule was broken.
"""

import argparse
import re
import resource
import shutil
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from hostile.referee import BrokenRule, examine
from hostile.table import CASES

MEMORY = 2 * 2**30  # bytes beyond what the process has once everything is loaded


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("words", nargs="?", default="", help="a regular expression")
    parser.add_argument("--share", default="0/1", metavar="K/N")
    arguments = parser.parse_args()
    share, shares = map(int, arguments.share.split("/"))
    chosen = [case for k, case in enumerate(CASES.values()) if k % shares == share and re.search(arguments.words, case.name)]
    scratch = Path(tempfile.mkdtemp(prefix="hostile-")).resolve()
    broken = 0
    try:
        warm_up(scratch / "warm")
        limit_memory()
        for number, case in enumerate(chosen):
            print(f"begin {case.name!r}", flush=True)
            sandbox = scratch / str(number)
            sandbox.mkdir()
            started = time.process_time()
            try:
                outcome = examine(sandbox, case.make(sandbox), case.options, names=case.names)
            except BrokenRule as error:
                broken += 1
                outcome = f"BROKEN {error}"
            print(f"done {time.process_time() - started:.2f} s {outcome}", flush=True)
            shutil.rmtree(sandbox)
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    print(f"{len(chosen)} cases, {broken} broke a rule", flush=True)
    return 1 if broken else 0


def warm_up(folder: Path) -> None:
    """Everything that will be imported is, and a sound capture of each kind is accepted."""
    from hostile.captures import LAYOUTS, write

    for layout in LAYOUTS:
        sandbox = folder / layout
        sandbox.mkdir(parents=True)
        outcome = examine(sandbox, write(layout, sandbox / "capture"))
        assert outcome == "accepted", (layout, outcome)


def limit_memory() -> None:
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    hard = resource.getrlimit(resource.RLIMIT_AS)[1]
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + MEMORY, hard))


if __name__ == "__main__":
    sys.exit(main())
