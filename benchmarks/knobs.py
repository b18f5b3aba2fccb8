"""Time and error of what can only be turned when the kernels are compiled: `python benchmarks/knobs.py [--out FILE.json] [--plot FILE]`.

Each variant of the native module is built in a temporary folder from a copy of the sources with one line changed, and loaded by a
process of its own. Needs a compiler, and in the environment `pip install cmake ninja nanobind`. Two errors are given, both against float64:
"rules" by the same rules (its own smallest alpha), outside pixels that a threshold decides, which shows rounding and the exponential;
"uncut" against an image in which no alpha is cut off, everywhere, which shows what the smallest alpha costs.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table

ROOT = Path(__file__).resolve().parents[1]
SOURCES = ("CMakeLists.txt", "__init__.py", "rasterizer", "scene", "vision")
USUAL = "default: 1/255, tiles of 16, degree 5"


@dataclass(frozen=True)
class Variant:
    """One line of a source changed. least: the smallest alpha that is blended."""

    path: str
    before: str
    after: str
    least: float = 1 / 255


def least_alpha(parts: int) -> Variant:
    return Variant("rasterizer/math/constants.h", "kMinAlpha = 1.0f / 255.0f;", f"kMinAlpha = 1.0f / {parts}.0f;", 1 / parts)


def exponential(*coefficients: float) -> Variant:
    """2^f = 1 + f p(f) for |f| <= 1/2, with the least largest relative error that the degree allows: 1e-4, 3e-6, 1e-7, 2e-9 for 3 to 6."""
    usual = "(0.001326472731307149f, 0.009671512991189957f, 0.05550733581185341f, 0.24022242426872253f, 0.6931470036506653f);"
    return Variant("rasterizer/cpu/elementary.inl", usual, f"({', '.join(f'{c!r}f' for c in coefficients)});")


VARIANTS: dict[str, Variant | None] = {
    USUAL: None,
    "least alpha 1/1020": least_alpha(1020),
    "least alpha 1/510": least_alpha(510),
    "least alpha 1/128": least_alpha(128),
    "least alpha 1/64": least_alpha(64),
    "tiles of 8": Variant("rasterizer/cpu/records.h", "kTile = 16;", "kTile = 8;"),
    "exponential of degree 3": exponential(0.055008928583013379, 0.24221096006037032, 0.69328292760180366),
    "exponential of degree 4": exponential(0.0095828528674781963, 0.055906424924600483, 0.2402409861671134, 0.69312419335866704),
    "exponential of degree 6": exponential(
        *(0.00015353361813644827, 0.0013398874445386521, 0.0096184373583006345),
        *(0.05550332471026901, 0.24022647913619644, 0.69314720285512865),
    ),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=VARIANTS, default=list(VARIANTS))
    parser.add_argument("--garden", type=Path, help="gsplat's test_garden.npz; a synthetic scene without it")
    parser.add_argument("--rounds", type=int, default=3, help="the variants take turns this often")
    parser.add_argument("--repeats", type=int, default=5, help="runs of each in a turn")
    parser.add_argument("--scale", type=float, default=1.0, help="fraction of all sizes, for a quick look")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--plot", type=Path, help="FILE.svg or FILE.png")
    parser.add_argument("--probe", metavar="MODULE", help=argparse.SUPPRESS)
    parser.add_argument("--least-alpha", type=float, default=1 / 255, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.probe:
        print(json.dumps(probe(Path(args.probe), args)))
        return
    console = Console()
    with tempfile.TemporaryDirectory() as folder:
        modules = {}
        for k, name in enumerate(args.only):
            console.print(f"building {k + 1}/{len(args.only)}: {name}", highlight=False)
            modules[name] = build(Path(folder) / str(k), VARIANTS[name])
        found: dict[str, dict] = {}
        for turn in range(args.rounds):
            for name in args.only:
                console.print(f"round {turn + 1}/{args.rounds}: {name}", highlight=False)
                merge(found, name, measured(modules[name], VARIANTS[name], args))
    report(console, found, args)


def copy_sources(folder: Path, variant: Variant | None) -> None:
    """The sources of the native modules, changed as the variant says."""
    for name in SOURCES:
        source, target = ROOT / name, folder / name
        if source.is_dir():
            shutil.copytree(source, target, ignore=shutil.ignore_patterns("*.so", "*.py", "__pycache__"))
        else:
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(source, target)
    if variant is not None:
        text = (folder / variant.path).read_text()
        if text.count(variant.before) != 1:
            raise SystemExit(f"{variant.path} does not have {variant.before!r} once: benchmarks/knobs.py is older than the kernels")
        (folder / variant.path).write_text(text.replace(variant.before, variant.after))


def build(folder: Path, variant: Variant | None) -> Path:
    """The native module of this variant, built in ``folder``."""
    import nanobind

    copy_sources(folder / "source", variant)
    cmake = shutil.which("cmake", path=str(Path(sys.executable).parent)) or shutil.which("cmake")
    if cmake is None:
        raise SystemExit("CMake was not found; pip install cmake ninja")
    configure = ["-S", str(folder / "source"), "-B", str(folder / "build"), "-DCMAKE_BUILD_TYPE=Release"]
    configure += [f"-DPython_EXECUTABLE={sys.executable}", f"-Dnanobind_DIR={nanobind.cmake_dir()}"]
    for command in (
        [cmake, *configure],
        [cmake, "--build", str(folder / "build"), "--target", "_cpu", "--parallel", str(os.cpu_count() or 1)],
    ):
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode:
            raise SystemExit(f"{' '.join(command)} failed:\n{done.stdout[-2000:]}{done.stderr[-2000:]}")
    return next(path for path in folder.rglob("_cpu*.so"))


def measured(module: Path, variant: Variant | None, args: argparse.Namespace) -> dict:
    """What `probe` finds in a process that loads this module."""
    least = 1 / 255 if variant is None else variant.least
    options = ["--least-alpha", str(least), "--repeats", str(args.repeats), "--scale", str(args.scale)]
    if args.garden:
        options += ["--garden", str(args.garden)]
    done = subprocess.run([sys.executable, __file__, "--probe", str(module), *options], capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{module}: {done.stderr[-3000:]}")
    return json.loads(done.stdout.splitlines()[-1])


def probe(module: Path, args: argparse.Namespace) -> dict:
    """Times the garden scene and compares smaller scenes with float64, with ``module`` in place of the installed one."""
    import e4dgs.rasterizer as package

    spec = importlib.util.spec_from_file_location("e4dgs.rasterizer._cpu", module)
    assert spec is not None and spec.loader is not None
    native = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(native)
    sys.modules["e4dgs.rasterizer._cpu"] = package._cpu = native  # type: ignore[attr-defined]

    import torch
    from bench_rows.raster.accuracy import COUNT, HEIGHT, SCENES, WIDTH, errors
    from e4dgs.rasterizer import cpu_backend
    from e4dgs.rasterizer.reference import blend, compare
    from e4dgs.workflows.bench.machine import kernels, machine
    from e4dgs.workflows.bench.render import both, forward
    from e4dgs.workflows.bench.rows import Bench
    from e4dgs.workflows.bench.scenes import garden
    from e4dgs.workflows.bench.timing import interleaved

    assert cpu_backend._cpu is native
    bench = Bench(args.scale, args.repeats, garden=args.garden)
    scene, name = garden(bench)
    times = interleaved(bench, {"forward": forward(scene), "both": both(scene)})
    rules, gradients, uncut = 0.0, 0.0, 0.0
    for make in SCENES.values():
        small = make(bench.count(COUNT, 10), *bench.size(WIDTH, HEIGHT))
        blend.MIN_ALPHA = compare.MIN_ALPHA = args.least_alpha  # type: ignore[attr-defined]
        image, by_name = errors(small, compare.decided_by_threshold(small))
        rules, gradients = max(rules, image), max(gradients, *by_name.values())
        blend.MIN_ALPHA = 0.0
        with torch.no_grad():
            got, want = small.render("cpu"), small.to(torch.float64).render("reference")
        uncut = max(uncut, float((got.color - want.color).abs().max()))  # depth jumps wherever a first layer appears
    found = {"scene": name, "machine": machine() | kernels(), "rules": rules, "gradients": gradients, "uncut": uncut}
    return found | {f"{what}_ms": [1e3 * seconds for seconds in t.runs] for what, t in times.items()}


def merge(found: dict[str, dict], name: str, more: dict) -> None:
    """Adds the runs of one turn to those of the turns before."""
    if name in found:
        for what in ("forward_ms", "both_ms"):
            more[what] = found[name][what] + more[what]
    found[name] = more


def report(console: Console, found: dict[str, dict], args: argparse.Namespace) -> None:
    from bench_rows.curves import Curve
    from bench_rows.plots import draw
    from e4dgs.workflows.bench.output import write

    columns = ("variant", "forward ms", "forward + backward ms", "error, rules", "gradients", "error, uncut")
    table = Table(*columns, box=None)
    rows, curves = [], []
    for name, v in found.items():
        best = min(v["forward_ms"]), min(v["both_ms"])
        rows.append([name, f"{best[0]:.1f}", f"{best[1]:.1f}", *(f"{v[what]:.1e}" for what in ("rules", "gradients", "uncut"))])
        table.add_row(*rows[-1])
        for plot, title in (("rules", "largest error of an image, by the same rules"), ("uncut", "largest error of an image, nothing cut")):
            curves.append(vars(Curve(plot, name, [best[1]], [v[plot]], "forward + backward, ms", title, [name])))
    console.print(table)
    first = next(iter(found.values()), {"machine": {}, "scene": ""})
    protocol = (
        f"{first['scene']}; best of {args.rounds} turns of {args.repeats} runs; errors: the largest over the scenes of the accuracy row"
    )
    row = {"what": "knobs that are turned when the kernels are compiled", "protocol": protocol, "checks": [], "numbers": found}
    row |= {"curves": curves, "columns": list(columns), "table": rows}
    if args.out:
        facts = {"suite": "knobs", "scale": args.scale, "judged": args.scale == 1, "repeats": args.repeats, "rounds": args.rounds}
        write(args.out, {"machine": first["machine"], "protocol": facts, "rows": {"knobs": row}})
    if args.plot:
        for path in draw(args.plot, {"knobs": row}):
            console.print(f"plot: {path}")


if __name__ == "__main__":
    main()
