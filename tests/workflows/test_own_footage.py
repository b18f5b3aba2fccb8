"""What people bring, each through the whole of `run all --preset fast`: nothing but budgets is set, and there is something to see."""

import json
import shutil
import struct
import zipfile
from pathlib import Path

import e4dgs
import pytest
import torch
from e4dgs.pipeline import Artifact
from e4dgs.stages.shared.frameset import FrameSet
from e4dgs.workflows.cli import main
from factory import Options, make, write_colmap, write_images, write_nerfies, write_video, write_videos

BUDGETS = {
    "coarse.iterations": 60,
    "seeds.count": 1500,
    "train.budget": 2500,
    "hulls.budget": 20,
    "fine.iterations": 4,
    "poses.max_features": 1500,
    "evaluate.movie_frames": 4,
}
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


def rig_without_poses(folder: Path) -> Path:
    return write_videos(make(Options(**{**ROOM, "rig": "arc"}, cameras=5, times=3, width=200, height=150)), folder / "event").root


def tripod(folder: Path) -> Path:
    """One camera that stands still."""
    options = Options(**{**ROOM, "rig": "arc"}, cameras=2, times=8, width=160, height=120)
    root = write_videos(make(options), folder / "event").root
    return Path(shutil.move(min(root.glob("*.mp4")), folder / "tripod.mp4"))


@pytest.mark.parametrize(
    "kind", [tripod, rotated_video, photos_of_two_sizes, nerfies, archive, rig_without_poses], ids=lambda kind: kind.__name__
)
def test_it_ends_in_a_model_that_shows_something(kind, tmp_path):
    capture, workspace = kind(tmp_path), tmp_path / "workspace"
    words = [word for key, value in BUDGETS.items() for word in ("--set", f"{key}={value}")]
    assert main(["run", "all", str(capture), "--workspace", str(workspace), "--preset", "fast", "--device", "cpu", *words]) == 0
    (scene,) = (workspace / "scenes").iterdir()
    metrics = json.loads((scene / "metrics.json").read_text())
    held_out = metrics["splits"].get("test") or metrics["splits"]["val"]  # Nerfies has validation views
    assert held_out["psnr"] > 10 and (scene / "report.html").is_file()

    found = {
        stage: Artifact(next((workspace / "store" / stage).iterdir()))
        for stage in ("frames", "poses")
        if (workspace / "store" / stage).is_dir()
    }
    frames = FrameSet(found["frames"], capture, found.get("poses"))
    assert frames.registered.all()
    i, model = int((*frames.test, *frames.val)[0]), e4dgs.load(scene)
    K, pose = (torch.as_tensor(array[i]).float() for array in (frames.K, frames.cam_from_world))
    with torch.no_grad():
        picture = model.render(e4dgs.Camera(K, pose, frames.width, frames.height), float(frames.time[i])).color
    assert picture.shape == (frames.height, frames.width, 3) and picture.isfinite().all()
    assert picture.std((0, 1)).min() > 0.05, "blank"
