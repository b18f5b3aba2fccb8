"""Masks of what moves against their truth, and whether captures are recognised as static.

    python benchmarks/moving.py SCENES [--out FILE.json] [--pictures DIR] [--only NAME ...]

SCENES is the folder of captures (../shared/scenes). Masks: `room_mono` with its poses, and again without them, against the `object` masks
of its flow files; `basketball` (fixed train cameras, every frame) against `seg/`; `balloon1` has no truth, its masks are for the eye.
Flow is DIS medium between neighbouring train frames, as the stage `flow` measures it; seconds are of the masks alone. Static decisions:
every capture as it is, and `stage` with its time stopped (each camera's first frame 45 times as H.264).
Writes JSON with protocol and machine, and a picture of overlays (red: masked) for each capture.
"""

from __future__ import annotations

import argparse
import itertools
import json
import shutil
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from e4dgs.pipeline import Artifact, ArtifactWriter, Progress
from e4dgs.stages.frames.settings import FramesSettings, recognise_for
from e4dgs.stages.frames.stage import Frames
from e4dgs.stages.shared.frameset import FrameSet
from e4dgs.vision.flow.two_way import FlowPair, consistency, dis_flow
from e4dgs.vision.moving.fixed_camera import fixed_camera_masks
from e4dgs.vision.moving.moving_masks import moving_masks
from e4dgs.vision.moving.static_scene import static_scene
from e4dgs.workflows.bench.machine import machine

STATIC = {"sceaux/images": True, "stage, time stopped": True, "balloon1/images": False, "room_video/room.mp4": False, "balloon1": False}
STATIC |= {"room_mono": False, "stage": False, "basketball": False, "lego": False, "robot": False}
MASKS = ("room_mono", "room_mono without poses", "balloon1", "basketball")
TILE = (400, 225)


def read(path: Path, folder: Path, **settings: Any) -> tuple[FrameSet, dict[str, Any]]:
    """Frames and facts of a capture; videos are decoded into `folder`."""
    options = FramesSettings(**settings)
    capture = recognise_for(path, options)
    out = Path(tempfile.mkdtemp(dir=folder)) / "frames"
    out.mkdir()
    context = SimpleNamespace(
        capture=capture,
        facts=capture.facts,
        settings=options,
        inputs={},
        earlier=None,
        out=ArtifactWriter(out),
        log=lambda text: None,
        progress=Progress,
    )
    Frames().run(context)  # type: ignore[arg-type]
    context.out.finish({})
    return FrameSet(Artifact(out), capture.root), dict(capture.facts)


def scores(masks: Iterable[np.ndarray], truths: Iterable[np.ndarray]) -> dict[str, float]:
    """Over frames whose truth or mask is not empty."""
    rows = []
    for mask, truth in zip(masks, truths, strict=True):
        both, either = np.count_nonzero((mask > 0) & truth), np.count_nonzero((mask > 0) | truth)
        if either:
            rows.append((both / either, both / max(1, np.count_nonzero(mask)), both / max(1, np.count_nonzero(truth))))
    iou, precision, recall = np.array(rows).T
    numbers = {"iou_mean": iou.mean(), "iou_median": np.median(iou), "iou_lowest": iou.min(), "precision": precision.mean()}
    return {name: round(float(value), 3) for name, value in {**numbers, "recall": recall.mean()}.items()} | {"frames": len(rows)}


def measured(first: np.ndarray, second: np.ndarray) -> FlowPair:
    forward, backward = dis_flow(first, second), dis_flow(second, first)
    return FlowPair(forward, backward, consistency(forward, backward))


def moving_camera(path: Path, folder: Path, posed: bool) -> tuple[list[np.ndarray], list[np.ndarray], list[str], float]:
    """Pictures, masks, names of the training frames, and the seconds of one mask."""
    frames, _ = read(path, folder, holdout=0)
    train = [int(i) for i in frames.train]
    pictures = [frames.composited(i) for i in train]
    pairs = [measured(a, b) for a, b in itertools.pairwise(pictures)]
    poses = (frames.K[train], frames.cam_from_world[train]) if posed and frames.K is not None and frames.cam_from_world is not None else ()
    started = time.perf_counter()
    masks = list(moving_masks(pictures.__getitem__, pairs, *poses))
    return pictures, masks, [frames.names[i] for i in train], (time.perf_counter() - started) / len(masks)


def measure_masks(name: str, scenes: Path, folder: Path, pictures_to: Path | None) -> dict[str, Any]:
    import cv2

    if name == "basketball":
        frames, _ = read(scenes / name, folder)
        pictures, masks, truths, seconds = [], [], [], 0.0
        for camera in np.unique(frames.camera[frames.train]):
            mine = [int(i) for i in frames.train if frames.camera[i] == camera]
            shown = [frames.composited(i) for i in mine]
            started = time.perf_counter()
            masks += fixed_camera_masks(shown)
            seconds += time.perf_counter() - started
            pictures += shown
            for i in mine:
                number, stem = Path(frames.names[i]).parts[-2:]
                truths.append(cv2.imread(str(scenes / name / "seg" / number / Path(stem).with_suffix(".png")), cv2.IMREAD_GRAYSCALE) > 0)
        sheet(pictures_to, name, pictures, masks, range(5, len(masks), 25))
        return {**scores(masks, truths), "seconds_per_frame": round(seconds / len(masks), 3)}
    posed = "without" not in name
    pictures, masks, names, seconds = moving_camera(scenes / name.split()[0], folder, posed)
    result: dict[str, Any] = {"seconds_per_frame": round(seconds, 3), "masked_share": round(float(np.mean([m > 0 for m in masks])), 4)}
    shown = range(0, len(masks), max(1, len(masks) // 12))
    files = sorted((scenes / name.split()[0] / "flow").glob("flow_*.npz")) if name.startswith("room_mono") else []
    if files:
        number = {int(Path(n).stem): k for k, n in enumerate(names)}
        of = {int(file.stem.split("_")[1]): file for file in files}
        shown = [number[i] for i in of]  # type: ignore[assignment]
        result |= scores([masks[k] for k in shown], [np.load(file)["object"] > 0 for file in of.values()])
    sheet(pictures_to, name.replace(" ", "_"), pictures, masks, shown)
    return result


def sheet(folder: Path | None, name: str, pictures: list[np.ndarray], masks: list[np.ndarray], shown: Iterable[int]) -> None:
    """Overlays of some frames, four a row."""
    if folder is None:
        return
    import cv2

    tiles = []
    for k in shown:
        tile = pictures[k].copy()
        tile[masks[k] > 0] = tile[masks[k] > 0] // 2 + np.array([127, 0, 0], np.uint8)
        tiles.append(cv2.resize(tile, TILE, interpolation=cv2.INTER_AREA))
    tiles += [np.zeros_like(tiles[0])] * (-len(tiles) % 4)
    rows = [np.hstack(tiles[i : i + 4]) for i in range(0, len(tiles), 4)]
    folder.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(folder / f"{name}.png"), cv2.cvtColor(np.vstack(rows), cv2.COLOR_RGB2BGR))


def stop_time(stage: Path, folder: Path) -> Path:
    """A copy of the capture in which every camera shows its first frame 45 times, encoded with x264."""
    import av

    stopped = folder / "stopped"
    stopped.mkdir()
    shutil.copy(stage / "poses_bounds.npy", stopped)
    for video in sorted(stage.glob("cam*.mp4")):
        with av.open(str(video)) as source:
            picture = next(source.decode(video=0)).to_ndarray(format="rgb24")
        with av.open(str(stopped / video.name), "w") as sink:
            stream = sink.add_stream("libx264", rate=30)
            stream.height, stream.width, stream.pix_fmt = picture.shape[0], picture.shape[1], "yuv420p"  # type: ignore[attr-defined]
            for _ in range(45):
                sink.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))  # type: ignore[attr-defined]
            sink.mux(stream.encode())  # type: ignore[attr-defined]
    return stopped


def measure_static(name: str, scenes: Path, folder: Path) -> dict[str, Any]:
    path = stop_time(scenes / "stage", folder) if name == "stage, time stopped" else scenes / name
    frames, facts = read(path, folder)
    train = np.asarray(frames.train)
    poses = () if frames.K is None or frames.cam_from_world is None else (frames.K[train], frames.cam_from_world[train])
    started = time.perf_counter()
    found = static_scene(
        lambda k: frames.composited(int(train[k])), frames.camera[train], frames.time[train], bool(facts["fixed_cameras"]), *poses
    )
    seconds = time.perf_counter() - started
    right = found.static == STATIC[name]
    share = round(found.largest_moving_share, 5)
    return {"static": found.static, "right": right, "largest_moving_share": share, "reason": found.reason, "seconds": round(seconds, 2)} | {
        "evidence": dict(found.evidence)
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", type=Path)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results" / "moving.json")
    parser.add_argument("--pictures", type=Path)
    parser.add_argument("--only", action="append", default=[], help="a name of the masks or of the static decisions")
    args = parser.parse_args()
    document: dict[str, Any] = {"machine": machine(), "protocol": " ".join((__doc__ or "").split("\n\n")[2].split())}
    with tempfile.TemporaryDirectory(prefix="e4dgs-moving-") as temporary:
        for group, names, measure in (("masks", MASKS, measure_masks), ("static", STATIC, measure_static)):
            document[group] = {}
            for name in names:
                if args.only and name not in args.only:
                    continue
                extra = (args.pictures,) if group == "masks" else ()
                document[group][name] = measure(name, args.scenes, Path(temporary), *extra)  # type: ignore[operator]
                print(group, name, json.dumps(document[group][name]), flush=True)
    args.out.parent.mkdir(parents=True, exist_ok=True)
    args.out.write_text(json.dumps(document, indent=1) + "\n")


if __name__ == "__main__":
    main()
