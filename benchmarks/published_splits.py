"""Two public data sets with the splits of their published tables, as captures that e4dgs recognises; see docs/reproduce.md.

    python benchmarks/published_splits.py without SCENE CAMERA OUT     a Plenoptic Video scene without one camera and its row of poses
    python benchmarks/published_splits.py nvidia SCENE TRUTH OUT       NVIDIA Dynamic Scenes as DynamicNeRF evaluates them

Videos are linked, not copied.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from PIL import Image


def without(scene: Path, camera: str, out: Path) -> None:
    """``out`` links all videos of ``scene`` but that of ``camera`` (`cam13`). Rows of poses_bounds.npy are in the order of the names."""
    videos = sorted(scene.glob("cam*.mp4"))
    rows = np.load(scene / "poses_bounds.npy", allow_pickle=False)
    if len(rows) != len(videos):
        raise SystemExit(f"{scene}: {len(rows)} rows of poses for {len(videos)} videos; download it again")
    kept = [i for i, video in enumerate(videos) if video.stem != camera]
    if len(kept) == len(videos):
        raise SystemExit(f"{scene}: there is no {camera}.mp4")
    out.mkdir(parents=True)
    for i in kept:
        (out / videos[i].name).symlink_to(videos[i].resolve())
    np.save(out / "poses_bounds.npy", rows[kept])


def nvidia(scene: Path, truth: Path, out: Path) -> None:
    """Training: picture i of ``scene`` (`images/`, `poses_bounds.npy`), which camera i took at time i. Test: ``truth`` has what camera 0
    saw at each time (`v000_tNNN.png`). Training pictures are scaled to the size of those by area."""
    pictures, rows = sorted((scene / "images").iterdir()), np.load(scene / "poses_bounds.npy", allow_pickle=False)
    tests = sorted(truth.glob("v000_t*.png"))
    if not len(pictures) == len(rows) == len(tests):
        raise SystemExit(f"{len(pictures)} pictures, {len(rows)} rows of poses and {len(tests)} true pictures; they must be as many")
    (out / "images").mkdir(parents=True)
    frames: list[dict] = []
    names: dict[str, list[str]] = {"train": [], "test": []}
    size = Image.open(tests[0]).size
    for split, files in (("train", pictures), ("test", tests)):
        for i, file in enumerate(files):
            name = f"images/{split}_{i:03d}.png"
            Image.open(file).convert("RGB").resize(size, Image.Resampling.BOX).save(out / name)
            down, right, back, centre, (_, width, focal) = rows[i if split == "train" else 0][:15].reshape(3, 5).T
            pose = np.eye(4)
            pose[:3] = np.stack([right, -down, back, centre], axis=1)
            lens = {"fl_x": focal * size[0] / width, "w": size[0], "h": size[1], "cx": size[0] / 2, "cy": size[1] / 2}
            frames.append({"file_path": name, "time": i / (len(rows) - 1), "transform_matrix": pose.tolist(), **lens})
            names[split].append(name)
    (out / "transforms.json").write_text(json.dumps({"frames": frames, **{f"{split}_filenames": names[split] for split in names}}))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    kinds = parser.add_subparsers(required=True)
    for kind, words in ((without, ("scene", "camera", "out")), (nvidia, ("scene", "truth", "out"))):
        own = kinds.add_parser(kind.__name__)
        own.set_defaults(run=kind)
        for word in words:
            own.add_argument(word, type=str if word == "camera" else Path)
    args = vars(parser.parse_args())
    args.pop("run")(**args)


if __name__ == "__main__":
    main()
