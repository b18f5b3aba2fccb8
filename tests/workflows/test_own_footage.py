"""What people bring, each through the whole of `run all --preset fast`: nothing but budgets is set, and there is something to see."""

import json
import shutil
import struct
import zipfile
from pathlib import Path

import e4dgs
import pytest
import torch
from e4dgs.workflows.cli import main
from factory import Options, make, write_colmap, write_images, write_nerfies, write_video

BUDGETS = {"coarse.iterations": 30, "coarse.seeds": 1500, "hulls.budget": 20, "fine.iterations": 4, "poses.max_features": 1500}
ROOM = {"backdrop": "room", "rig": "path", "samples": 1, "fov_degrees": 60.0}


def rotated_video(folder: Path) -> Path:
    """Stored lying, with a matrix in its track that turns it upright, as phones do."""
    file = write_video(make(Options(**ROOM, times=7, width=160, height=120)), folder / "upright.mp4").root
    data = bytearray(file.read_bytes())
    struct.pack_into(">9i", data, data.index(b"tkhd") + 44, 0, 1 << 16, 0, -1 << 16, 0, 0, 120 << 16, 0, 1 << 30)
    file.write_bytes(data)
    return file


def photos_of_two_sizes(folder: Path) -> Path:
    sizes = ((160, 120), (160, 120), (192, 144))
    return write_images(make(Options(**ROOM, times=7, width=160, height=120, sizes=sizes)), folder / "photos").root


def nerfies(folder: Path) -> Path:
    return write_nerfies(make(Options(**ROOM, times=8, width=64, height=48)), folder / "nerfies").root


def archive(folder: Path) -> Path:
    root = write_colmap(make(Options(**ROOM, times=6, width=64, height=48)), folder / "plain").root
    with zipfile.ZipFile(folder / "packed.zip", "w") as file:
        for path in sorted(root.rglob("*")):
            file.write(path, Path("deep/er") / path.relative_to(root))
    shutil.rmtree(root)
    return folder / "packed.zip"


@pytest.mark.parametrize(
    "kind", [rotated_video, photos_of_two_sizes, nerfies, archive, "videos"], ids=lambda kind: getattr(kind, "__name__", kind)
)
def test_it_ends_in_a_model_that_shows_something(kind, videos_capture, tmp_path):
    capture = videos_capture.root if kind == "videos" else kind(tmp_path)
    words = [word for key, value in BUDGETS.items() for word in ("--set", f"{key}={value}")]
    workspace = tmp_path / "workspace"
    assert main(["run", "all", str(capture), "--workspace", str(workspace), "--preset", "fast", "--device", "cpu", *words]) == 0
    (scene,) = (workspace / "scenes").iterdir()
    metrics = json.loads((scene / "metrics.json").read_text())
    assert metrics["splits"]["test"]["psnr"] > 8 and (scene / "report.html").is_file()

    plan = json.loads((scene / "plan.json").read_text())["recognised"]
    model = e4dgs.load(scene)
    (frames,) = (workspace / "store/frames").iterdir()
    print(plan, metrics["splits"], frames)
