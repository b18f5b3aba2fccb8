"""The rows of the tables of quality on the pages: what each runs, what was kept of it, and by which code it is out of date.

`results/rows/NAME.json` holds one row: its runs, one a seed, all by one machine and the same code.
"""

from __future__ import annotations

import json
import statistics
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROWS_FOLDER = Path(__file__).resolve().parent / "results" / "rows"
FAST, CUDA = ("--preset", "fast"), "cuda"


@dataclass(frozen=True)
class Row:
    """`e4dgs run all` on ``capture`` (below the folder of captures) with ``options``. title, views: for the table."""

    capture: str
    title: str
    views: str
    options: tuple[str, ...] = ()
    device: str = "cpu"


ROOM, DOG, WHITE = "room_video/room.mp4", "dog_gooses/dog-gooses.mp4", "D-NeRF lego, white"
TEST, EIGHTH, BOTH = "test", "every 8th frame", "test / val"
COMPACT = ("--preset", "compact")
WITHOUT_CONVEXES = ("--preset", "compact", "--set", "train.budget=5400", "--set", "hulls.budget=0")  # as many parameters in Gaussians alone
ROWS: dict[str, Row] = {
    "basketball": Row("basketball", "basketball (Panoptic, 27 cameras, 12 of 150 times)", TEST),
    "basketball-fast": Row("basketball", "basketball", TEST, FAST),
    "stage": Row("stage", "stage (rendered rig of 8 cameras)", TEST),
    "stage-fast": Row("stage", "stage", TEST, FAST),
    "stage-compact": Row("stage", "stage", TEST, COMPACT),
    "stage-compact-gaussians": Row("stage", "stage", TEST, WITHOUT_CONVEXES),
    "room-video": Row(ROOM, "room.mp4 (rendered hand-held video), poses by SfM", EIGHTH),
    "room-video-fast": Row(ROOM, "room.mp4", EIGHTH, FAST),
    "dog-gooses": Row(DOG, "dog-gooses (DAVIS), poses by SfM, without its watermark", EIGHTH),
    "lego": Row("lego", WHITE, BOTH),
    "lego-fast": Row("lego", WHITE, BOTH, FAST),
    "robot": Row("robot", "robot (rendered, D-NeRF layout), white", BOTH),
    "room-mono": Row("room_mono", "room_mono, views off the camera's path", TEST),
    "balloon1": Row("balloon1", "balloon1 (NVIDIA, 12 frames of one camera)", EIGHTH),
    "sceaux-static": Row("sceaux/images", "sceaux (11 photos)", EIGHTH, ("--static", "--set", "frames.max_size=708")),
    "lego-cuda": Row("lego", "lego", BOTH, device=CUDA),
    "robot-cuda": Row("robot", "robot", BOTH, device=CUDA),
    "basketball-cuda": Row("basketball", "basketball", TEST, device=CUDA),
    "lego-best-cuda": Row("lego", "lego", BOTH, ("--preset", "best", "--set", "coarse.effort=2"), CUDA),
}


def kept(name: str) -> dict[str, Any] | None:
    """The measured row; None if there is none."""
    path = ROWS_FOLDER / f"{name}.json"
    return json.loads(path.read_text()) if path.is_file() else None


def keep(name: str, row: dict[str, Any]) -> None:
    ROWS_FOLDER.mkdir(parents=True, exist_ok=True)
    (ROWS_FOLDER / f"{name}.json").write_text(json.dumps(row, indent=1) + "\n")


def trimmed(metrics: dict) -> dict:
    """Without the rows of each view and of each pair of times, which the report keeps."""
    splits = {name: {k: v for k, v in split.items() if k != "per_view"} for name, split in metrics["splits"].items()}
    flicker = {k: v for k, v in (metrics.get("flicker") or {}).items() if k != "per_pair"}
    return metrics | {"splits": splits, "flicker": flicker or None}


def code_now(device: str) -> dict[str, str]:
    """The digest of the product's code that each stage reaches."""
    from e4dgs.pipeline.code.reach import code_of
    from e4dgs.workflows.reconstruction import reconstruction

    stages = reconstruction().stages.items()
    return {name: code_of(type(stage), stage.device_class and device == CUDA)["digest"][:16] for name, stage in stages}


def stale(name: str, row: dict[str, Any]) -> str | None:
    """Why the row is not of today's code: what it ran with, or the stages whose code has changed. None if it is."""
    if (row["capture"], row["options"]) != (ROWS[name].capture, list(ROWS[name].options)):
        return "another capture or other options"
    now = code_now(ROWS[name].device)
    codes = [run["code"] for run in row["runs"]]
    if not all(codes):
        return "measured before the digest of the code was kept"
    return ", ".join(sorted({stage for run in row["runs"] for stage in differing(run, now)})) or None


def differing(run: dict[str, Any], now: dict[str, str]) -> list[str]:
    """The stages of a run whose code is another today."""
    return [stage for stage, digest in run["code"].items() if now.get(stage) != digest]


def mean(row: dict[str, Any], of: Callable[[dict[str, Any]], float | None]) -> float | None:
    """Mean over the runs of the row; None unless all have it."""
    found = [of(run) for run in row["runs"]]
    return None if None in found else statistics.mean(found)  # type: ignore[type-var]


def metric(row: dict[str, Any], split: str, key: str) -> float | None:
    return mean(row, lambda run: (run["metrics"]["splits"].get(split) or {}).get(key))


def held_out(row: dict[str, Any]) -> list[str]:
    splits: Iterable[str] = row["runs"][0]["metrics"]["splits"]
    return [split for split in ("test", "val") if split in splits] or ["train"]


def spread(row: dict[str, Any], split: str) -> float | None:
    """The highest PSNR of the seeds minus the lowest; None for one seed."""
    values = [run["metrics"]["splits"][split]["psnr"] for run in row["runs"]]
    return max(values) - min(values) if len(values) > 1 else None
