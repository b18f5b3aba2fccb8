#!/usr/bin/env python
"""Damages small sound captures at random and gives them to e4dgs, for as long as it is told.

    python tests/hostile/fuzz_captures.py --minutes 60 --seed 0

Each damage that breaks a rule of referee.py is written to tests/hostile/corpus, which the tests replay. The one in hand is in the file
that it names, should the process die. Exit code 1 where any broke a rule.
"""

import argparse
import json
import random
import shutil
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from hostile.captures import LAYOUTS
from hostile.mutations import make
from hostile.referee import BrokenRule, examine
from hostile.run_table import limit_memory, warm_up

CORPUS = Path(__file__).with_name("corpus")


def drawn(draw: random.Random) -> list[dict]:
    """As `mutations.mutations` draws them, faster."""
    do = ["flip", "write", "cut", "drop", "repeat", "json"]
    return [
        {"file": draw.randrange(41), "do": draw.choice(do), "at": draw.random(), "to": draw.random(), "value": draw.randrange(256)}
        for _ in range(draw.randint(1, 3))
    ]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--corpus", type=Path, default=CORPUS)
    arguments = parser.parse_args()
    draw, outcomes = random.Random(arguments.seed), Counter()
    scratch = Path(tempfile.mkdtemp(prefix="fuzz-captures-")).resolve()
    in_hand = scratch / "in-hand.json"
    print(f"seed {arguments.seed}; the case in hand is in {in_hand}", flush=True)
    warm_up(scratch / "warm")
    limit_memory()
    end = time.monotonic() + 60 * arguments.minutes
    while time.monotonic() < end:
        entry = {"layout": draw.choice(list(LAYOUTS)), "steps": drawn(draw)}
        in_hand.write_text(json.dumps(entry))
        sandbox = scratch / "sandbox"
        sandbox.mkdir()
        try:
            outcome = "accepted" if examine(sandbox, make(entry["layout"], entry["steps"], sandbox)) == "accepted" else "refused"
        except BrokenRule as error:
            outcome = "broke a rule"
            print(f"{entry['layout']}: {error}", flush=True)
            arguments.corpus.mkdir(exist_ok=True)
            (arguments.corpus / f"{arguments.seed}-{sum(outcomes.values())}.json").write_text(json.dumps(entry) + "\n")
        outcomes[outcome] += 1
        shutil.rmtree(sandbox)
    shutil.rmtree(scratch)
    print(f"{sum(outcomes.values())} captures: " + ", ".join(f"{count} {outcome}" for outcome, count in outcomes.most_common()))
    return 1 if outcomes["broke a rule"] else 0


if __name__ == "__main__":
    sys.exit(main())
