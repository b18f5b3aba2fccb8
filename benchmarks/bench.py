"""All rows of the benchmark: those of `e4dgs bench`, and those that compare with torch, with gsplat, and with limits.

    python benchmarks/bench.py raster|field|cuda|step [--rows NAME,NAME] [--list] [--garden FILE.npz] [--capture CAPTURE]
        [--out FILE.json] [--plot FILE.svg] [--threads N] [--repeats N] [--seconds S] [--scale X]

--garden is gsplat's test_garden.npz, for raster and cuda; a synthetic scene without it. --capture has poses, for step and cuda; the sample
without it. --plot draws the curves, a file for each. Some rows compile a library, and want a C++ compiler.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from bench_rows.plots import draw
from bench_rows.suites import SUITES
from e4dgs.pipeline import SettingsError, say
from e4dgs.workflows.bench.rows import Bench
from e4dgs.workflows.bench.run import run
from e4dgs.workflows.bench.suites import REPEATS, SECONDS
from e4dgs.workflows.machine.terminal import make_console


def main(words: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("suite", choices=SUITES)
    parser.add_argument("--rows", metavar="NAME,NAME", help="only these rows")
    parser.add_argument("--list", action="store_true", help="name the rows and measure nothing")
    parser.add_argument("--garden", type=Path, metavar="FILE.npz")
    parser.add_argument("--capture", type=Path)
    parser.add_argument("--out", type=Path, metavar="FILE.json")
    parser.add_argument("--plot", type=Path, metavar="FILE.svg")
    parser.add_argument("--threads", type=int, default=0, help="0 takes all cores")
    parser.add_argument("--repeats", type=int, help=f"runs of each contender: {REPEATS}")
    parser.add_argument("--seconds", type=float, help=f"most time for the runs of one contender together: {SECONDS}")
    parser.add_argument("--scale", type=float, default=1.0, help="fraction of all sizes, for a quick look; bars hold at 1 only")
    args = parser.parse_args(words)
    seconds = SECONDS[args.suite] if args.seconds is None else args.seconds
    bench = Bench(args.scale, args.repeats or REPEATS[args.suite], seconds, args.garden, args.capture)
    console = make_console()
    options = {"names": args.rows, "only_list": args.list, "threads": args.threads, "out": args.out}
    try:
        measured = run(args.suite, SUITES[args.suite], bench, **options, console=console)
    except SettingsError as wrong:
        raise SystemExit(str(wrong)) from wrong
    if args.plot and measured:
        for path in draw(args.plot, measured):
            say(f"plot: {path}", to=console)


if __name__ == "__main__":
    main()
