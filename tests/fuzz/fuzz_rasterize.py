#!/usr/bin/env python
"""Feeds `rasterize` with arguments that nobody should give it, forward and backward, for as long as it is told.

    python tests/fuzz/fuzz_rasterize.py --minutes 60 --seed 0
    python tests/fuzz/fuzz_rasterize.py --case 0:1234          one case again, with its traceback

Every case is made from (seed, index). The one in hand is in the state file, so that a crash of the process names it. A case that
breaks an invariant is written to the corpus, which tests/fuzz/test_corpus.py replays; --collect also writes the first case of each
new kind of outcome. Exit code 1 where anything broke.
"""

import argparse
import json
import os
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from fuzz.cases import make_case
from fuzz.invariants import Broken, run

HERE = Path(__file__).resolve().parent


def attempt(seed: int, index: int) -> tuple[str, str]:
    """(kind of outcome, what broke or nothing) of one case."""
    try:
        return run(make_case(seed, index)), ""
    except Broken as broken:
        return "broken", str(broken)
    except Exception as error:  # a fuzzer's finding, whatever it is
        return "broken", f"{type(error).__name__}: {error}"


def keep(corpus: Path, seed: int, index: int, kind: str) -> None:
    corpus.mkdir(parents=True, exist_ok=True)
    (corpus / f"{seed}-{index}.json").write_text(json.dumps({"seed": seed, "index": index, "kind": kind}) + "\n")


def fuzz(minutes: float, seed: int, corpus: Path, collect: bool, state: Path) -> int:
    kinds: Counter[str] = Counter()
    failures: list[str] = []
    started = said = time.monotonic()
    end, index = started + 60 * minutes, 0
    print(f"seed {seed}; the case in hand is in {state}")
    with open(state, "w+b", buffering=0) as file:
        while (now := time.monotonic()) < end:
            os.pwrite(file.fileno(), f"{seed}:{index}\n".ljust(40).encode(), 0)
            kind, broken = attempt(seed, index)
            if broken:
                failures.append(f"--case {seed}:{index}  {broken}")
                print(f"\n{failures[-1]}", flush=True)
                keep(corpus, seed, index, f"broken: {broken}")
            elif collect and not kinds[kind]:
                keep(corpus, seed, index, kind)
            kinds[kind] += 1
            index += 1
            if now - said > (2 if sys.stdout.isatty() else 30):
                said, left = now, int(end - now)
                line = f"{left // 60}:{left % 60:02} left, {index} cases, {len(failures)} failures, {len(kinds)} kinds of outcome"
                print(f"\r{line}" if sys.stdout.isatty() else line, end="" if sys.stdout.isatty() else "\n", flush=True)
    seconds = time.monotonic() - started
    print(f"\n{index} cases in {seconds:.0f} s ({60 * index / max(seconds, 1e-9):.0f} a minute)")
    refused = sum(count for kind, count in kinds.items() if kind.startswith("refused"))
    print(f"{refused} were refused as they must be, {len(failures)} broke an invariant")
    print(f"{len(kinds)} kinds of outcome:")
    for kind, count in kinds.most_common():
        print(f"{count:9}  {kind}")
    print("\n".join(failures[:50]))
    return 1 if failures else 0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--corpus", type=Path, default=HERE / "corpus")
    parser.add_argument("--collect", action="store_true", help="also keep the first case of each kind of outcome")
    parser.add_argument("--state", type=Path, default=Path(tempfile.gettempdir()) / "e4dgs-fuzz-case.txt")
    parser.add_argument("--case", metavar="SEED:INDEX", help="run this one case, and say all about it")
    arguments = parser.parse_args()
    if arguments.case:
        seed, index = (int(number) for number in arguments.case.split(":"))
        case = make_case(seed, index)
        print(case)
        print(run(case))
        return 0
    return fuzz(arguments.minutes, arguments.seed, arguments.corpus, arguments.collect, arguments.state)


if __name__ == "__main__":
    sys.exit(main())
