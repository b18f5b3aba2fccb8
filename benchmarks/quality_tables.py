"""The tables of quality for the pages, from `results/rows/`: the README's, that of all columns, and those of GPUs and of memory."""

from __future__ import annotations

import json
from typing import Any

from quality_rows import CUDA, ROWS, ROWS_FOLDER, held_out, kept, mean, metric, spread

SHOWN = ("basketball", "stage", "room-video", "dog-gooses", "lego", "lego-fast", "robot", "room-mono", "sceaux-static")
MEMORY = {"D-NeRF scene": ("lego",), "rig": ("basketball", "stage"), "hand-held video": ("room-video", "dog-gooses")}
MEMORY |= {"photos of a static scene, `--static`": ("sceaux-static",)}
SAYS_NOTHING = "-"


def number(value: float | None, digits: int) -> str:
    return SAYS_NOTHING if value is None else f"{value:,.{digits}f}"


def table(heads: list[str], rows: list[list[str]]) -> str:
    first, *others = ("| " + " | ".join(cells) + " |" for cells in (heads, *rows))
    return "\n".join([first, "|" + "---|" * len(heads), *others])


def measured(device: str) -> dict[str, dict[str, Any]]:
    return {name: row for name in ROWS if ROWS[name].device == device and (row := kept(name)) is not None}


def titled(name: str) -> str:
    return ", ".join([ROWS[name].title, *([f"`{' '.join(ROWS[name].options)}`"] if ROWS[name].options else [])])


def minutes(row: dict[str, Any]) -> str:
    return number(mean(row, lambda run: run["seconds"] / 60), 1)


def trained(row: dict[str, Any], between: str) -> str:
    """PSNR of training views, and after a colour fit where there was one."""
    return between.join(number(value, 2) for key in ("psnr", "psnr_affine") if (value := metric(row, "train", key)) is not None)


def results() -> str:
    """The README's: held-out views, two splits with a slash between them."""
    heads = ["capture", "resolution, held out", "PSNR, dB", "SSIM", "LPIPS", "edge PSNR", "after colour fit", "training views", "minutes"]
    lines: list[list[str]] = []
    found = {name: row for name in SHOWN if (row := kept(name)) is not None}
    for name, row in found.items():
        cells = [
            " / ".join(number(metric(row, split, key), digits) for split in held_out(row))
            for key, digits in (("psnr", 2), ("ssim", 3), ("lpips", 3), ("edge_psnr", 2))
        ]
        size = row["runs"][0]["metrics"]["protocol"]["resolution"]
        over = spread(row, held_out(row)[0])
        cells[0] += f" (of {len(row['runs'])}: {over:.2f})" if over is not None else ""
        cells = [cell if any(map(str.isdigit, cell)) else SAYS_NOTHING for cell in cells]
        fitted = number(metric(row, held_out(row)[0], "psnr_affine"), 2)
        lines.append([titled(name), f"{size}, {ROWS[name].views}", *cells, fitted, trained(row, ", fitted "), minutes(row)])
    return f"{table(heads, lines)}\n\n{origin(found)}"


def origin(rows: dict[str, dict[str, Any]]) -> str:
    """Sentences that say of which commit and machine ``rows`` are, and which of them are of older code."""
    runs = [run for row in rows.values() for run in row["runs"]]
    places = {(run["commit"], run["machine"]["processor"], run["machine"].get("cores")) for run in runs}
    stale = [name for name, row in rows.items() if row["stale"]]
    if len(places) == 1:
        (commit, processor, cores), last = places.pop(), max(run["machine"].get("date", "") for run in runs)
        changed = sorted({stage for name in stale for stage in rows[name]["stale"].split(", ")})
        since = f" The code of {', '.join(changed)} has changed since." if changed else ""
        return f"All rows are of commit {commit} ({last}; {processor}, {cores} cores).{since}"
    told = "all" if len(stale) == len(rows) else ", ".join(stale) or "none"
    return f"Rows of an older version: {told}."


def whole_runs() -> str:
    """Every column of every row: a line for each split that is held out."""
    heads = ["row", "views", "seeds", "PSNR", "spread", "SSIM", "LPIPS", "foreground", "moving", "edges", "after colour fit"]
    heads += ["training views, after colour fit", "flicker: static, edges, along motion", "Gaussians + convexes", "MB", "ms a frame"]
    heads += ["minutes", "others' cores", "commit"]
    lines = []
    for device in ("cpu", CUDA):
        for name, row in measured(device).items():
            lines += [[titled(name), *line(row, split)] for split in held_out(row)]
    missing = ", ".join(f"`{name}`" for name in ROWS if kept(name) is None)
    return table(heads, lines) + (f"\n\nNot measured yet: {missing}." if missing else "")


def line(row: dict[str, Any], split: str) -> list[str]:
    digits = {"psnr": 2, "ssim": 4, "lpips": 4, "psnr_foreground": 2, "psnr_moving": 2, "edge_psnr": 2, "psnr_affine": 2}
    cells = [number(metric(row, split, key), n) for key, n in digits.items()]
    cells.insert(1, number(spread(row, split), 2))
    flicker = [mean(row, lambda run, key=key: (run["metrics"]["flicker"] or {}).get(key)) for key in ("static", "edges", "warped")]
    count = [mean(row, lambda run, kind=kind: run["metrics"]["primitives"][kind]) for kind in ("gaussians", "convexes")]
    speed = mean(row, lambda run: 1000 / run["metrics"]["render_fps"] if run["metrics"]["render_fps"] else None)
    run = row["runs"][0]
    others = mean(row, lambda run: run["others"])
    beside = number(others, 1) if others is not None else f"load {number(run['machine'].get('load'), 1)}"
    commit = run["commit"] + (" (stale)" if row["stale"] else "")
    views = f"{split}, {run['metrics']['protocol']['resolution']}"
    return [
        *(views, str(len(row["runs"])), *cells, trained(row, ", ")),
        *(SAYS_NOTHING if None in flicker else ", ".join(number(value, 2) for value in flicker),),
        *(" + ".join(number(value, 0) for value in count), number(mean(row, lambda run: run["megabytes"]), 1), number(speed, 1)),
        *(minutes(row), beside, commit),
    ]


def gpus() -> str:
    heads = ["capture", "GPU", "training", "whole run", "PSNR"]
    lines = []
    for name, row in measured(CUDA).items():
        device = row["runs"][0]["machine"]["gpu"].split(",")[0]
        training = mean(row, lambda run: run["metrics"]["train_seconds"])
        psnr = ", ".join(f"{split} {number(metric(row, split, 'psnr'), 2)}" for split in held_out(row))
        lines.append([titled(name), device, f"{number(training, 0)} s", f"{number(mean(row, lambda run: run['seconds']), 0)} s", psnr])
    return table(heads, lines)


def memory() -> str:
    """The largest stage's peak in the row's first run; for rows that did not keep it, of `results/stages.json`."""
    earlier = json.loads((ROWS_FOLDER.parent / "stages.json").read_text())
    lines = []
    for what, names in MEMORY.items():
        peaks, pictures = [], []
        for name in names:
            run = (kept(name) or {"runs": [{"metrics": {}}]})["runs"][0]["metrics"].get("stages", {})
            known = [stage["peak_rss_mb"] for stage in run.values()] or earlier[name]["peak_mb"].values()
            peaks.append(f"{max(known) / 1000:.1f} GB")
            pictures.append(f"{ROWS[name].capture.partition('/')[0]}, {earlier[name]['size']}")
        lines.append([what, "; ".join(pictures), "; ".join(peaks)])
    return table(["capture", "pictures", "memory, the largest stage"], lines)


TABLES = {"results": results, "whole_runs": whole_runs, "gpus": gpus, "memory": memory}
