"""Lay a synthetic capture out as the tools of this field do; every writer renders the views and says where each one went."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from .camera import Camera
from .render import Truth, render, to_uint8
from .scene import Synthetic, View

Pixels = NDArray[np.uint8]
OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])


@dataclass(frozen=True)
class Capture:
    """A capture on disk beside its truth. `files[i]` is the file of `views[i]`, relative to `root` (for videos: the video).

    `os.fspath(capture)` and `Path(capture)` give `root`, so a capture can stand where a path is expected.
    """

    root: Path
    synthetic: Synthetic
    views: tuple[View, ...]
    files: tuple[str, ...]

    def __fspath__(self) -> str:
        return str(self.root)


def write_dnerf(synthetic: Synthetic, root: Path) -> Capture:
    """D-NeRF: transforms_{train,val,test}.json with camera_angle_x and times, RGBA PNG files with straight alpha."""
    views, files = [], []
    for split in ("train", "val", "test"):
        frames = []
        for i, view in enumerate(synthetic.split(split)):
            name = f"{split}/r_{i:03d}"
            _save(root / f"{name}.png", to_uint8(_truth(synthetic, view).image))
            frames.append({"file_path": f"./{name}", "time": view.time, "transform_matrix": _opengl_pose(view.camera)})
            views.append(view)
            files.append(f"{name}.png")
        if frames:
            angle = 2.0 * np.arctan(0.5 * views[-1].camera.width / views[-1].camera.K[0, 0])
            _save_json(root / f"transforms_{split}.json", {"camera_angle_x": float(angle), "frames": frames})
    return Capture(root, synthetic, tuple(views), tuple(files))


def write_n3v(synthetic: Synthetic, root: Path, crf: int = 12) -> Capture:
    """Plenoptic Video: camNN.mp4 and poses_bounds.npy, whose rows are [down, right, back, centre, (h, w, f)], near, far."""
    views, files, rows = [], [], []
    for index in sorted({view.camera_index for view in synthetic.views}):
        own = [view for view in synthetic.views if view.camera_index == index]
        truths = [_truth(synthetic, view) for view in own]
        write_mp4(root / f"cam{index:02d}.mp4", (flatten(truth) for truth in truths), synthetic.options.fps, crf)
        camera = own[0].camera
        pose = camera.world_from_cam[:3]
        llff = np.stack([pose[:, 1], pose[:, 0], -pose[:, 2], pose[:, 3], [camera.height, camera.width, camera.K[0, 0]]], axis=1)
        depths = np.concatenate([truth.depth[truth.depth > 0] for truth in truths])
        rows.append(np.concatenate([llff.ravel(), [0.9 * depths.min(), 1.1 * depths.max()]]))
        views += own
        files += [f"cam{index:02d}.mp4"] * len(own)
    np.save(root / "poses_bounds.npy", np.stack(rows))
    return Capture(root, synthetic, tuple(views), tuple(files))


def write_panoptic(synthetic: Synthetic, root: Path) -> Capture:
    """Panoptic as prepared by Dynamic 3D Gaussians: {train,test}_meta.json indexed [time][camera], ims/, seg/ (moving objects)."""
    views, files = [], []
    moving = [i for i, item in enumerate(synthetic.scene.objects) if item.motion.moves]
    for split in ("train", "test"):
        chosen = synthetic.split(split)
        meta: dict = {"w": synthetic.options.width, "h": synthetic.options.height, "k": [], "w2c": [], "fn": [], "cam_id": []}
        for moment in sorted({view.time_index for view in chosen}):
            now = [view for view in chosen if view.time_index == moment]
            names = [f"{view.camera_index}/{moment:06d}.jpg" for view in now]
            for view, name in zip(now, names):
                truth = _truth(synthetic, view)
                _save(root / "ims" / name, flatten(truth), quality=97)
                mask = Image.fromarray(np.isin(truth.object, moving)).convert("1")
                (root / "seg" / name).parent.mkdir(parents=True, exist_ok=True)
                mask.save((root / "seg" / name).with_suffix(".png"))
                views.append(view)
                files.append(f"ims/{name}")
            meta["k"].append([view.camera.K.tolist() for view in now])
            meta["w2c"].append([view.camera.cam_from_world.tolist() for view in now])
            meta["fn"].append(names)
            meta["cam_id"].append([view.camera_index for view in now])
        _save_json(root / f"{split}_meta.json", meta)
    return Capture(root, synthetic, tuple(views), tuple(files))


def write_nerfstudio(synthetic: Synthetic, root: Path) -> Capture:
    """transforms.json of nerfstudio and instant-ngp: OpenGL poses, times, intrinsics and distortion at its head, or on every frame where
    they differ."""
    files = _write_frames(synthetic, root / "images", "images/")
    lenses = [_nerfstudio_lens(view.camera) for view in synthetic.views]
    shared = all(lens == lenses[0] for lens in lenses)
    frames = [
        {"file_path": name, "time": view.time, "transform_matrix": _opengl_pose(view.camera), **({} if shared else lens)}
        for view, name, lens in zip(synthetic.views, files, lenses)
    ]
    _save_json(root / "transforms.json", {**(lenses[0] if shared else {}), "frames": frames})
    return Capture(root, synthetic, synthetic.views, files)


def write_nerfies(synthetic: Synthetic, root: Path, points: int = 200) -> Capture:
    """Nerfies and HyperNeRF: dataset.json, metadata.json, scene.json, camera/, rgb/1x and rgb/2x, points.npy; in a world of its own, which
    scene.json brings to ours. Where all views are for training, every third from the second on is for validation."""
    center, scale = np.array([1.5, -2.0, 0.25]), 0.125
    to_file = lambda x: x / scale + center  # noqa: E731
    names = [f"{view.camera_index}_{view.time_index:06d}" for view in synthetic.views]
    held_out = {i for i, view in enumerate(synthetic.views) if view.split != "train"} or set(range(1, len(names), 3))
    for view, name in zip(synthetic.views, names):
        picture, camera = flatten(_truth(synthetic, view)), view.camera
        _save(root / f"rgb/1x/{name}.png", picture)
        _save(root / f"rgb/2x/{name}.png", to_uint8(picture.reshape(camera.height // 2, 2, camera.width // 2, 2, 3).mean((1, 3)) / 255))
        k1, k2, p1, p2, k3 = (*camera.distortion, 0.0)[:5]
        lens = {
            "skew": 0.0,
            "radial_distortion": [k1, k2, k3],
            "tangential_distortion": [p1, p2],
            "image_size": [camera.width, camera.height],
        }
        K = camera.K
        lens |= {"focal_length": K[0, 0], "pixel_aspect_ratio": K[1, 1] / K[0, 0], "principal_point": K[:2, 2].tolist()}
        pose = {"orientation": camera.cam_from_world[:3, :3].tolist(), "position": to_file(camera.centre).tolist()}
        _save_json(root / f"camera/{name}.json", {**pose, **lens})
    entries = {
        name: {"warp_id": view.time_index, "appearance_id": view.time_index, "camera_id": view.camera_index}
        for view, name in zip(synthetic.views, names)
    }
    _save_json(root / "metadata.json", entries)
    _save_json(root / "scene.json", {"scale": scale, "center": center.tolist(), "near": 0.1, "far": 2.0})
    lists = {
        "train_ids": [n for i, n in enumerate(names) if i not in held_out],
        "val_ids": [n for i, n in enumerate(names) if i in held_out],
    }
    _save_json(root / "dataset.json", {"count": len(names), "num_exemplars": len(lists["train_ids"]), "ids": names, **lists})
    np.save(root / "points.npy", to_file(surface_points(synthetic, points)[0]))
    return Capture(root, synthetic, synthetic.views, tuple(f"rgb/1x/{name}.png" for name in names))


def write_images(synthetic: Synthetic, root: Path) -> Capture:
    """A bare folder of numbered images, nothing else."""
    return Capture(root, synthetic, synthetic.views, _write_frames(synthetic, root, ""))


def write_video(synthetic: Synthetic, file: Path, crf: int = 12) -> Capture:
    """One video file; `root` is the file itself."""
    write_mp4(file, (flatten(_truth(synthetic, view)) for view in synthetic.views), synthetic.options.fps, crf)
    return Capture(file, synthetic, synthetic.views, (file.name,) * len(synthetic.views))


def write_videos(synthetic: Synthetic, root: Path, crf: int = 12) -> Capture:
    """Each camera's video under the name of a letter, `a.mp4`, `b.mp4`, ..., and nothing else."""
    views, files = [], []
    for index in sorted({view.camera_index for view in synthetic.views}):
        own = [view for view in synthetic.views if view.camera_index == index]
        name = f"{chr(ord('a') + index)}.mp4"
        write_mp4(root / name, (flatten(_truth(synthetic, view)) for view in own), synthetic.options.fps, crf)
        views += own
        files += [name] * len(own)
    return Capture(root, synthetic, tuple(views), tuple(files))


def write_colmap(synthetic: Synthetic, root: Path, points: int = 200) -> Capture:
    """A COLMAP text model in sparse/0 with true poses and points on the visible surfaces, images in images/; a camera for each lens."""
    files = _write_frames(synthetic, root / "images", "")
    model = root / "sparse" / "0"
    model.mkdir(parents=True)
    lenses = [_colmap_lens(view.camera) for view in synthetic.views]
    distinct = list(dict.fromkeys(lenses))
    (model / "cameras.txt").write_text("".join(f"{i + 1} {lens}\n" for i, lens in enumerate(distinct)))
    lines = []
    for i, (view, name) in enumerate(zip(synthetic.views, files)):
        pose = [*_quaternion(view.camera.cam_from_world[:3, :3]), *view.camera.cam_from_world[:3, 3]]
        lines += [f"{i + 1} " + " ".join(f"{x:.17g}" for x in pose) + f" {distinct.index(lenses[i]) + 1} {name}", ""]
    (model / "images.txt").write_text("\n".join(lines) + "\n")

    lines = []
    for point, colour in zip(*surface_points(synthetic, points)):
        lines.append(f"{len(lines) + 1} " + " ".join(f"{x:.17g}" for x in point) + " " + " ".join(map(str, colour)) + " 0.0")
    (model / "points3D.txt").write_text("\n".join(lines) + "\n")
    return Capture(root, synthetic, synthetic.views, tuple(f"images/{name}" for name in files))


def surface_points(synthetic: Synthetic, count: int) -> tuple[NDArray[np.float64], Pixels]:
    """Points [P,3] on what the views see, each at its view's time, and their colours [P,3]; about `count`, as many of each view."""
    rng = np.random.default_rng(synthetic.options.seed)
    world, colours = [], []
    for view in synthetic.views:
        truth = _truth(synthetic, view)
        rows, columns = np.nonzero(truth.object >= 0)
        picked = rng.choice(len(rows), min(len(rows), -(-count // len(synthetic.views))), replace=False)
        rows, columns = rows[picked], columns[picked]
        origin, directions = view.camera.rays(np.stack([columns, rows], axis=-1) + 0.5)
        world.append(origin + truth.depth[rows, columns, None] * directions)
        colours.append(to_uint8(truth.image[rows, columns, :3]))
    return np.concatenate(world), np.concatenate(colours)


def write_mp4(file: Path, frames: Iterable[Pixels], fps: float, crf: int = 12, sound: NDArray[np.float32] | None = None) -> None:
    """Encode RGB frames [H,W,3] with H.264; one thread, so that the file has the same bytes on every machine with the same codec.

    sound [N]: 16000 samples a second in [-1, 1], from the first frame on, as AAC."""
    import av

    file.parent.mkdir(parents=True, exist_ok=True)
    with av.open(str(file), "w") as container:
        stream = container.add_stream("libx264", rate=round(fps))
        stream.pix_fmt = "yuv420p"
        stream.options = {"crf": str(crf), "threads": "1", "preset": "fast"}
        audio = None if sound is None else container.add_stream("aac", rate=16000, layout="mono")
        for i, pixels in enumerate(frames):
            if i == 0:
                stream.height, stream.width = pixels.shape[:2]
                if stream.width % 2 or stream.height % 2:
                    raise ValueError(f"4:2:0 video needs even sizes, not {stream.width}x{stream.height}")
            container.mux(stream.encode(av.VideoFrame.from_ndarray(np.ascontiguousarray(pixels), format="rgb24")))
        container.mux(stream.encode())
        if audio is not None and sound is not None:
            heard = av.AudioFrame.from_ndarray(np.ascontiguousarray(sound[None], np.float32), format="fltp", layout="mono")
            heard.sample_rate, heard.pts = 16000, 0
            container.mux(audio.encode(heard))
            container.mux(audio.encode())


def flatten(truth: Truth, background: float = 1.0) -> Pixels:
    """[H,W,3]: the image over a grey level."""
    alpha = truth.image[..., 3:]
    return to_uint8(truth.image[..., :3] * alpha + background * (1.0 - alpha))


def _nerfstudio_lens(camera: Camera) -> dict:
    names = ("k1", "k2", "k3", "k4") if camera.fisheye else ("k1", "k2", "p1", "p2", "k3")
    K = camera.K
    return {
        "camera_model": "OPENCV_FISHEYE" if camera.fisheye else "OPENCV",
        "fl_x": float(K[0, 0]),
        "fl_y": float(K[1, 1]),
        "cx": float(K[0, 2]),
        "cy": float(K[1, 2]),
        "w": camera.width,
        "h": camera.height,
        **dict(zip(names, camera.distortion)),
    }


def _colmap_lens(camera: Camera) -> str:
    """The line of cameras.txt behind the number."""
    name = "OPENCV_FISHEYE" if camera.fisheye else "OPENCV" if len(camera.distortion) == 4 else "FULL_OPENCV"
    numbers = [camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2], *camera.distortion]
    return f"{name} {camera.width} {camera.height} " + " ".join(f"{x:.17g}" for x in numbers)


def _write_frames(synthetic: Synthetic, folder: Path, prefix: str) -> tuple[str, ...]:
    names = [f"{i:03d}.png" for i in range(len(synthetic.views))]
    for view, name in zip(synthetic.views, names):
        _save(folder / name, flatten(_truth(synthetic, view)))
    return tuple(prefix + name for name in names)


def _truth(synthetic: Synthetic, view: View) -> Truth:
    return render(synthetic.scene, view.camera, view.time, synthetic.options.samples)


def _opengl_pose(camera: Camera) -> list[list[float]]:
    return (camera.world_from_cam @ OPENGL_FROM_OPENCV).tolist()


def _quaternion(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """w, x, y, z of a rotation [3,3]: the eigenvector of Bar-Itzhack's symmetric matrix with the largest eigenvalue."""
    r = rotation
    m = np.array(
        [
            [r[0, 0] + r[1, 1] + r[2, 2], r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]],
            [r[2, 1] - r[1, 2], r[0, 0] - r[1, 1] - r[2, 2], r[0, 1] + r[1, 0], r[0, 2] + r[2, 0]],
            [r[0, 2] - r[2, 0], r[0, 1] + r[1, 0], r[1, 1] - r[0, 0] - r[2, 2], r[1, 2] + r[2, 1]],
            [r[1, 0] - r[0, 1], r[0, 2] + r[2, 0], r[1, 2] + r[2, 1], r[2, 2] - r[0, 0] - r[1, 1]],
        ]
    )
    q = np.linalg.eigh(m)[1][:, -1]
    return q if q[0] >= 0 else -q


def _save(file: Path, pixels: Pixels, **options: int) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(pixels).save(file, **options)


def _save_json(file: Path, value: dict) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps(value, indent=1) + "\n")
