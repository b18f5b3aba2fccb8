"""What a second run does: nothing, or only what depends on the change, or the rest of what was killed.

    python benchmarks/reruns.py CAPTURE [--workspace DIR] [--set stage.key=value ...]

Runs `e4dgs run all`, again unchanged, again with another fine.iterations, and once more in a new workspace with SIGKILL in the middle of
`coarse`. Prints the state of every stage each time and writes results/reruns.json.
"""

from __future__ import annotations

import argparse
import json
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

from e4dgs.workflows.bench.machine import machine


def command(capture: Path, workspace: Path, options: list[str]) -> list[str]:
    return [
        sys.executable,
        "-m",
        "e4dgs.workflows.cli",
        "run",
        "all",
        str(capture),
        "--workspace",
        str(workspace),
        "--name",
        "scene",
        *options,
    ]


def states(workspace: Path) -> dict[str, str]:
    stages = json.loads((workspace / "scenes" / "scene" / "metrics.json").read_text())["stages"]
    return {name: row["state"] for name, row in stages.items()}


def timed(arguments: list[str]) -> float:
    started = time.monotonic()
    subprocess.run(arguments, check=True, capture_output=True)
    return round(time.monotonic() - started, 2)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path)
    parser.add_argument("--workspace", type=Path, default=Path("e4dgs-workspace/reruns"))
    parser.add_argument("--set", dest="settings", action="append", default=[])
    args = parser.parse_args()
    options = [word for setting in args.settings for word in ("--set", setting)]
    shutil.rmtree(args.workspace, ignore_errors=True)
    first, second = args.workspace / "first", args.workspace / "killed"
    results: dict[str, object] = {"machine": machine(), "capture": args.capture.name, "settings": args.settings}

    results["first run"] = {"seconds": timed(command(args.capture, first, options)), "states": states(first)}
    results["unchanged"] = {"seconds": timed(command(args.capture, first, options)), "states": states(first)}
    changed = [*options, "--set", "fine.iterations=60"]
    results["fine.iterations=60"] = {"seconds": timed(command(args.capture, first, changed)), "states": states(first)}

    process = subprocess.Popen(command(args.capture, second, options), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while process.poll() is None and not list(second.glob("store/checkpoints/coarse-*/training.safetensors")):
        time.sleep(0.2)
    if process.poll() is not None:
        raise SystemExit("coarse ended before its first checkpoint; give it more iterations with --set coarse.iterations=...")
    process.send_signal(signal.SIGKILL)
    process.wait()
    published = [path.parent.name for path in second.glob("store/*/*/manifest.json")]
    done = subprocess.run(command(args.capture, second, options), check=True, capture_output=True, text=True)
    continued = [line.strip() for line in (done.stdout + done.stderr).splitlines() if "continued from the checkpoint" in line]
    psnr = {w.name: json.loads((w / "scenes/scene/metrics.json").read_text())["splits"]["test"]["psnr"] for w in (first, second)}
    results["killed in coarse"] = {
        "published before the kill": len(published),
        "said": continued,
        "states": states(second),
        "test psnr": psnr["killed"],
    }

    out = Path(__file__).parent / "results" / "reruns.json"
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(json.dumps(results, indent=1) + "\n")
    print(json.dumps(results, indent=1))


if __name__ == "__main__":
    main()
