"""Small captures in the layouts of public data sets, as docs/reproduce.md says that these come."""

import json
from pathlib import Path

import numpy as np
from factory import Options, Synthetic, View, make, render, write_n3v, write_nerfies, write_panoptic
from factory.writers import flatten
from PIL import Image

RIG = {"backdrop": "room", "rig": "arc", "width": 80, "height": 64, "samples": 1, "fov_degrees": 60.0}
TRUTH = "truth"  # beside the NVIDIA scene


def coffee_martini(root: Path) -> None:
    """Plenoptic Video with a camera 13 between others: cam00, cam01, cam13, cam14."""
    write_n3v(make(Options(**RIG, cameras=4, times=6)), root)
    for index, name in ((3, "cam14"), (2, "cam13")):
        (root / f"cam{index:02d}.mp4").rename(root / f"{name}.mp4")


def vrig(root: Path) -> None:
    """HyperNeRF's validation rig: two cameras, which take turns at training; the other one of each time is held out."""
    write_nerfies(make(Options(**RIG, cameras=2, times=6)), root)
    split(root, lambda camera, time: (camera + time) % 2 == 0)


def iphone(root: Path) -> None:
    """DyCheck: one camera trains, two more are held out, of which covisibility masks say what counts: the left half."""
    synthetic = make(Options(**RIG, cameras=3, times=6))
    write_nerfies(synthetic, root)
    split(root, lambda camera, time: camera == 1)
    for folder in ("covisible/1x/val", "depth/1x", "splits"):
        (root / folder).mkdir(parents=True)
    for view in synthetic.views:
        name = f"{view.camera_index}_{view.time_index:06d}"
        if view.camera_index == 1:
            np.save(root / f"depth/1x/{name}.npy", truth(synthetic, view).depth[..., None].astype(np.float32))
        else:
            seen = np.zeros((64, 80), np.uint8)
            seen[:, :40] = 255
            Image.fromarray(seen).save(root / f"covisible/1x/val/{name}.png")


def panoptic(root: Path) -> None:
    write_panoptic(make(Options(**RIG, cameras=4, times=4)), root)


def nvidia(root: Path) -> None:
    """DynamicNeRF's NVIDIA Dynamic Scenes: picture i is of camera i at time i; half as large in `truth/`, camera 0 at each time."""
    synthetic = make(Options(**RIG, cameras=6, times=6))
    rows = []
    for folder in ("images", TRUTH):
        (root / folder).mkdir(parents=True)
    for view in synthetic.views:
        picture = Image.fromarray(flatten(truth(synthetic, view)))
        if view.camera_index == view.time_index:
            picture.save(root / f"images/{view.time_index:03d}.png")
            pose, K = view.camera.world_from_cam[:3], view.camera.K
            llff = np.stack([pose[:, 1], pose[:, 0], -pose[:, 2], pose[:, 3], [64, 80, K[0, 0]]], axis=1)
            rows.append([*llff.ravel(), 0.1, 10.0])
        if view.camera_index == 0:
            picture.resize((40, 32), Image.Resampling.BOX).save(root / f"{TRUTH}/v000_t{view.time_index:03d}.png")
    np.save(root / "poses_bounds.npy", rows)


def split(root: Path, trains) -> None:
    """Rewrites dataset.json: `trains(camera, time)` says which ids, "camera_time", are for training."""
    data = json.loads((root / "dataset.json").read_text())
    train = [name for name in data["ids"] if trains(*map(int, name.split("_")))]
    held_out = [name for name in data["ids"] if name not in train]
    (root / "dataset.json").write_text(json.dumps(data | {"num_exemplars": len(train), "train_ids": train, "val_ids": held_out}))


def truth(synthetic: Synthetic, view: View):
    return render(synthetic.scene, view.camera, view.time, synthetic.options.samples)


PUBLIC = {
    "data/n3v/coffee_martini_all": coffee_martini,
    "data/hypernerf/vrig-chicken": vrig,
    "data/iphone/apple": iphone,
    "data/panoptic/basketball": panoptic,
    "data/nvidia/Balloon1": nvidia,
}
