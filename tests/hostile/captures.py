"""Tiny sound captures of every layout, to be damaged: a few pictures of 12x8 px, written within milliseconds."""

from __future__ import annotations

import io
import json
import struct
import zipfile
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
from PIL import Image

SIZE = (12, 8)
FOCAL = 10.0
CLOUD = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\nend_header\n0 0 -1\n1 0 -2\n"


def pose(i: int) -> np.ndarray:
    """[4,4]: cameras in a row, looking ahead."""
    result = np.eye(4)
    result[0, 3] = 0.1 * i
    return result


@cache
def png(i: int = 0) -> bytes:
    pixels = np.random.default_rng(i).integers(0, 255, (SIZE[1], SIZE[0], 3), np.uint8)
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "PNG")
    return buffer.getvalue()


@cache
def mp4(seed: int = 0) -> bytes:
    """Six frames of 32x24, H.264."""
    import av

    buffer = io.BytesIO()
    with av.open(buffer, "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=10, options={"threads": "1"})
        stream.width, stream.height, stream.pix_fmt = 32, 24, "yuv420p"
        for i in range(6):
            pixels = np.random.default_rng((seed, i)).integers(0, 255, (24, 32, 3), np.uint8)
            for packet in stream.encode(av.VideoFrame.from_ndarray(pixels, format="rgb24")):
                container.mux(packet)
        for packet in stream.encode(None):
            container.mux(packet)
    return buffer.getvalue()


def put(root: Path, name: str, content: bytes | str | dict) -> None:
    file = root / name
    file.parent.mkdir(parents=True, exist_ok=True)
    data = json.dumps(content) if isinstance(content, dict) else content
    file.write_bytes(data.encode() if isinstance(data, str) else data)


def images(root: Path) -> None:
    for i in range(4):
        put(root, f"{i}.png", png(i))


def hinted(root: Path) -> None:
    images(root)
    put(root, "K.txt", "10 0 6 0 10 4 0 0 1\n")


def masked(root: Path) -> None:
    """A flat folder of photos that EXIF data turn, with masks as stored, one of them of 16 bits."""
    exif = Image.Exif()
    exif[0x0112] = 6
    for i in range(4):
        buffer = io.BytesIO()
        Image.open(io.BytesIO(png(i))).save(buffer, "JPEG", exif=exif)
        put(root, f"{i}.jpg", buffer.getvalue())
        keep = np.full(SIZE[::-1], 255, np.uint8)
        keep[:, :4] = 0
        buffer = io.BytesIO()
        Image.fromarray(keep if i else keep.astype(np.uint16) * 257).save(buffer, "TIFF" if i == 1 else "PNG")
        put(root, f"masks/{i}.{'tif' if i == 1 else 'png'}", buffer.getvalue())


def colmap_rig(root: Path) -> None:
    colmap_text(root)
    rows = []
    for i in range(4):
        name = f"cam{i // 2}/{i % 2}.png"
        put(root, f"images/{name}", png(i))
        put(root, f"masks/{name}", png(0))
        (root / f"images/{i}.png").unlink()
        rows.append(f"{i + 1} 1 0 0 0 {0.1 * (i // 2)} 0 0 1 {name}\n\n")
    put(root, "sparse/0/images.txt", "".join(rows))


def nerfstudio(root: Path) -> None:
    images(root)
    frames = [{"file_path": f"{i}.png", "time": i / 3, "transform_matrix": pose(i).tolist()} for i in range(4)]
    put(root, "transforms.json", {"fl_x": FOCAL, "w": 12, "h": 8, "ply_file_path": "cloud.ply", "frames": frames})
    put(root, "cloud.ply", CLOUD)


def dnerf(root: Path) -> None:
    for split, count in (("train", 3), ("test", 1)):
        frames = [{"file_path": f"./{split}/{i}", "time": i / 3, "transform_matrix": pose(i).tolist()} for i in range(count)]
        put(root, f"transforms_{split}.json", {"camera_angle_x": 1.0, "frames": frames})
        for i in range(count):
            put(root, f"{split}/{i}.png", png(i))


def panoptic(root: Path) -> None:
    K = [[FOCAL, 0, 6], [0, FOCAL, 4], [0, 0, 1]]
    for split, cameras in (("train", (1, 2)), ("test", (0,))):
        names = [[f"{c}/{t}.png" for c in cameras] for t in range(2)]
        poses = [[pose(c).tolist() for c in cameras]] * 2
        put(
            root, f"{split}_meta.json", {"w": 12, "h": 8, "fn": names, "k": [[K] * len(cameras)] * 2, "w2c": poses, "cam_id": [cameras] * 2}
        )
        for row in names:
            for name in row:
                put(root, f"ims/{name}", png(len(name)))
                put(root, f"seg/{name}", png(0))
    np.savez(root / "init_pt_cld.npz", data=np.ones((3, 7)))


def nerfies(root: Path) -> None:
    names = [f"{i:03d}" for i in range(4)]
    put(root, "dataset.json", {"train_ids": names[:3], "val_ids": names[3:]})
    put(root, "metadata.json", {name: {"warp_id": i, "camera_id": 0} for i, name in enumerate(names)})
    put(root, "scene.json", {"scale": 0.5, "center": [0, 0, 0]})
    for i, name in enumerate(names):
        put(root, f"rgb/1x/{name}.png", png(i))
        camera = {"orientation": np.eye(3).tolist(), "position": [0.1 * i, 0, 0], "focal_length": FOCAL, "principal_point": [6, 4]}
        put(root, f"camera/{name}.json", {**camera, "image_size": list(SIZE), "skew": 0, "radial_distortion": [0, 0, 0]})
    np.save(root / "points.npy", np.ones((3, 3)))


def colmap_text(root: Path) -> None:
    put(root, "sparse/0/cameras.txt", "# cameras\n1 PINHOLE 12 8 10 10 6 4\n")
    put(root, "sparse/0/images.txt", "".join(f"{i + 1} 1 0 0 0 {0.1 * i} 0 0 1 {i}.png\n\n" for i in range(4)))
    put(root, "sparse/0/points3D.txt", "1 0 0 1 255 0 0 0.1 1 0\n")
    for i in range(4):
        put(root, f"images/{i}.png", png(i))


def colmap(root: Path) -> None:
    put(root, "sparse/0/cameras.bin", struct.pack("<QiiQQ4d", 1, 1, 1, 12, 8, 10, 10, 6, 4))
    rows = [struct.pack("<i7di", i + 1, 1, 0, 0, 0, 0.1 * i, 0, 0, 1) + f"{i}.png\0".encode() + struct.pack("<Q", 0) for i in range(4)]
    put(root, "sparse/0/images.bin", struct.pack("<Q", 4) + b"".join(rows))
    put(root, "sparse/0/points3D.bin", struct.pack("<QQ3d3BdQii", 1, 1, 0, 0, 1, 255, 0, 0, 0.1, 1, 1, 0))
    for i in range(4):
        put(root, f"images/{i}.png", png(i))


def n3v(root: Path) -> None:
    matrix = np.column_stack([[0, 1, 0], [1, 0, 0], [0, 0, -1], [0, 0, 0], [8, 12, FOCAL]])
    np.save(root / "poses_bounds.npy", np.tile(np.concatenate([matrix.ravel(), [1, 9]]), (3, 1)))
    for camera in range(3):
        for t in range(3):
            put(root, f"cam{camera:02d}/{t}.png", png(t))


def video(root: Path) -> None:
    put(root, "clip.mp4", mp4())


def videos(root: Path) -> None:
    put(root, "a.mp4", mp4(0))
    put(root, "b.mp4", mp4(1))


def archive(root: Path) -> None:
    with zipfile.ZipFile(root / "capture.zip", "w", zipfile.ZIP_DEFLATED) as file:
        for i in range(4):
            file.writestr(f"scene/{i}.png", png(i))


def llff(root: Path) -> None:
    for i in range(4):
        put(root, f"images/{i}.png", png(i))
    np.save(root / "poses_bounds.npy", np.stack([pose_row(i) for i in range(4)]))


def multiview(root: Path) -> None:
    for camera in range(1, 4):
        for t in range(2):
            put(root, f"cam0{camera}/frame_0000{t + 1}.png", png(camera))
    put(root, "sparse_/cameras.txt", "1 PINHOLE 12 8 10 10 6 4\n")
    put(root, "sparse_/images.txt", "".join(f"{i} 1 0 0 0 {0.1 * i} 0 0 1 image{i}.jpg\n\n" for i in range(1, 4)))
    np.save(root / "poses_bounds_multipleview.npy", np.stack([pose_row(i) for i in range(3)]))
    put(root, "points3D_multipleview.ply", CLOUD)


def pose_row(i: int) -> np.ndarray:
    matrix = np.column_stack([[0, 1, 0], [1, 0, 0], [0, 0, -1], [0.1 * i, 0, 0], [SIZE[1], SIZE[0], FOCAL]])
    return np.append(matrix.ravel(), [0.1, 9.0])


def record3d(root: Path) -> None:
    for i in range(4):
        put(root, f"rgbd/{i}.png", png(i))
    data = {"w": 12, "h": 8, "K": [10, 0, 0, 0, 10, 0, 6, 4, 1], "fps": 30, "frameTimestamps": [0, 1, 2, 3]}
    put(root, "metadata.json", {**data, "poses": [[0, 0, 0, 1, 0.1 * i, 0, 0] for i in range(4)]})


def polycam(root: Path) -> None:
    for i in range(4):
        put(root, f"keyframes/images/{i}.png", png(i))
        matrix = {f"t_{r}{c}": float(pose(i)[r, c]) for r in range(3) for c in range(4)}
        put(root, f"keyframes/cameras/{i}.json", {**matrix, "fx": 10, "fy": 10, "cx": 6, "cy": 4, "width": 12, "height": 8})


def stray(root: Path) -> None:
    put(root, "rgb.mp4", mp4())
    put(root, "camera_matrix.csv", "30,0,16\n0,30,12\n0,0,1\n")
    put(
        root,
        "odometry.csv",
        "timestamp, frame, x, y, z, qx, qy, qz, qw\n" + "".join(f"{i}.0, {i:06d}, {0.1 * i}, 0, 0, 0, 0, 0, 1\n" for i in range(4)),
    )


def rgbd(root: Path) -> None:
    put(root, "K.txt", "10 0 6 0 10 4 0 0 1\n")
    for i in range(4):
        put(root, f"frame-{i}.color.png", png(i))
        put(root, f"frame-{i}.pose.txt", f"1 0 0 {0.1 * i}\n0 1 0 0\n0 0 1 0\n0 0 0 1\n")


def tum(root: Path) -> None:
    put(root, "K.txt", "10 0 6 0 10 4 0 0 1\n")
    for i in range(4):
        put(root, f"rgb/{i}.png", png(i))
    put(root, "rgb.txt", "".join(f"{i}.0 rgb/{i}.png\n" for i in range(4)))
    put(root, "groundtruth.txt", "".join(f"{i}.0 {0.1 * i} 0 0 0 0 0 1\n" for i in range(4)))


LAYOUTS: dict[str, Callable[[Path], None]] = {
    "images": images,
    "nerfstudio": nerfstudio,
    "dnerf": dnerf,
    "panoptic": panoptic,
    "nerfies": nerfies,
    "colmap_text": colmap_text,
    "colmap": colmap,
    "n3v": n3v,
    "video": video,
    "videos": videos,
    "archive": archive,
    "hinted": hinted,
    "masked": masked,
    "colmap_rig": colmap_rig,
    "llff": llff,
    "multiview": multiview,
    "record3d": record3d,
    "polycam": polycam,
    "stray": stray,
    "rgbd": rgbd,
    "tum": tum,
}


def write(layout: str, root: Path) -> Path:
    """The sound capture of `LAYOUTS` in the new folder `root`, and what a person would give as CAPTURE."""
    root.mkdir(parents=True)
    LAYOUTS[layout](root)
    return root / "capture.zip" if layout == "archive" else root
