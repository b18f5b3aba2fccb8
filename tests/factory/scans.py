"""Lay a synthetic capture out as devices and trackers store it, and as LLFF and 4DGaussians do."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .scene import Synthetic, View
from .writers import OPENGL_FROM_OPENCV, Capture, _opengl_pose, _quaternion, _save, _save_json, _truth, flatten, write_mp4


def _pictures(synthetic: Synthetic, root: Path, name: str, first: int = 0) -> tuple[str, ...]:
    files = []
    for i, view in enumerate(synthetic.views):
        files.append(name.format(i + first, view=view))
        _save(root / files[-1], flatten(_truth(synthetic, view)), **({"quality": 95} if name.endswith("jpg") else {}))
    return tuple(files)


def llff_row(view: View) -> np.ndarray:
    """[17]: down, right, back, centre, (h, w, f); near, far."""
    pose, camera = view.camera.world_from_cam[:3], view.camera
    columns = [pose[:, 1], pose[:, 0], -pose[:, 2], pose[:, 3], [camera.height, camera.width, camera.K[0, 0]]]
    return np.concatenate([np.stack(columns, axis=1).ravel(), [0.5, 9.0]])


def write_llff(synthetic: Synthetic, root: Path, name: str = "IMG_{:04d}.png") -> Capture:
    """images/ and poses_bounds.npy, whose rows have the plain order of the names."""
    files = _pictures(synthetic, root, f"images/{name}")
    order = sorted(range(len(files)), key=lambda i: files[i])
    np.save(root / "poses_bounds.npy", np.stack([llff_row(synthetic.views[i]) for i in order]))
    return Capture(root, synthetic, synthetic.views, files)


def write_record3d(synthetic: Synthetic, root: Path, folder: str = "rgbd") -> Capture:
    """metadata.json with K column by column and [qx qy qz qw tx ty tz] in OpenGL axes, and 0.jpg, 1.jpg, ... beside depth maps."""
    files = _pictures(synthetic, root, folder + "/{}.jpg")
    for file in files:
        (root / file).with_suffix(".depth").write_bytes(b"bvx2")
    poses = []
    for view in synthetic.views:
        pose = view.camera.world_from_cam @ OPENGL_FROM_OPENCV
        w, x, y, z = _quaternion(pose[:3, :3])
        poses.append([x, y, z, w, *pose[:3, 3]])
    camera = synthetic.views[0].camera
    data = {"w": camera.width, "h": camera.height, "K": camera.K.T.ravel().tolist(), "fps": 60, "dw": 4, "dh": 4, "poses": poses}
    _save_json(root / "metadata.json", data)
    return Capture(root, synthetic, synthetic.views, files)


def write_polycam(synthetic: Synthetic, root: Path, corrected: bool = False) -> Capture:
    """keyframes/ with pictures and cameras under time stamps, and depth/."""
    prefix = "corrected_" if corrected else ""
    files = _pictures(synthetic, root, f"keyframes/{prefix}images/" + "{}.jpg", first=99999)
    for view, file in zip(synthetic.views, files):
        pose, K = _opengl_pose(view.camera), view.camera.K
        data = {f"t_{r}{c}": pose[r][c] for r in range(3) for c in range(4)}
        data |= {"fx": K[0, 0], "fy": K[1, 1], "cx": K[0, 2], "cy": K[1, 2], "width": view.camera.width, "height": view.camera.height}
        _save_json(root / f"keyframes/{prefix}cameras/{Path(file).stem}.json", {**data, "blur_score": 90.0})
        _save(root / f"keyframes/depth/{Path(file).stem}.png", np.full((4, 4), 1000, np.uint16))
    return Capture(root, synthetic, synthetic.views, files)


def write_stray(synthetic: Synthetic, root: Path) -> Capture:
    """Stray Scanner: rgb.mp4, odometry.csv (camera to world, OpenCV axes), camera_matrix.csv, depth/ in mm and confidence/."""
    files = tuple(f"rgb.mp4#{i}" for i in range(len(synthetic.views)))
    write_mp4(root / "rgb.mp4", (flatten(_truth(synthetic, view)) for view in synthetic.views), 60)
    rows = ["timestamp, frame, x, y, z, qx, qy, qz, qw"]
    for i, view in enumerate(synthetic.views):
        w, x, y, z = _quaternion(view.camera.world_from_cam[:3, :3])
        numbers = [*view.camera.world_from_cam[:3, 3], x, y, z, w]
        rows.append(f"{5000 + i / 60:.6f}, {i:06d}, " + ", ".join(f"{v:.12f}" for v in numbers))
        _save(root / f"depth/{i:06d}.png", np.full((16, 20), 1500 + i, np.uint16))
        _save(root / f"confidence/{i:06d}.png", np.full((16, 20), 2, np.uint8))
    (root / "odometry.csv").write_text("\n".join(rows) + "\n")
    (root / "imu.csv").write_text("timestamp, a_x, a_y, a_z, alpha_x, alpha_y, alpha_z\n")
    np.savetxt(root / "camera_matrix.csv", synthetic.views[0].camera.K, delimiter=", ")
    return Capture(root, synthetic, synthetic.views, files)


def write_rgbd(synthetic: Synthetic, root: Path) -> Capture:
    """7-Scenes: frame-000000.color.png, .depth.png and .pose.txt (camera to world, OpenCV axes) in one folder, and K.txt."""
    files = _pictures(synthetic, root, "frame-{:06d}.color.png")
    for view, file in zip(synthetic.views, files):
        np.savetxt(root / file.replace("color.png", "pose.txt"), view.camera.world_from_cam, delimiter="\t", fmt="%.12e")
        _save(root / file.replace("color", "depth"), np.full((4, 4), 1000, np.uint16))
    np.savetxt(root / "K.txt", synthetic.views[0].camera.K)
    return Capture(root, synthetic, synthetic.views, files)


def write_tum(synthetic: Synthetic, root: Path) -> Capture:
    """rgb.txt, groundtruth.txt with a pose 4 ms before and after each picture, rgb/, and K.txt."""
    start = 1305031102.175304
    files = _pictures(synthetic, root, "rgb/{}.png")
    rows, listed = ["# timestamp tx ty tz qx qy qz qw"], ["# color images"]
    for i, (view, file) in enumerate(zip(synthetic.views, files)):
        w, x, y, z = _quaternion(view.camera.world_from_cam[:3, :3])
        centre = view.camera.world_from_cam[:3, 3]
        listed.append(f"{start + i / 30:.6f} {file}")
        for side in (-1, 1):  # the middle of the two is the pose of the picture
            moved = centre + side * np.array([0.002, -0.001, 0.003])
            sign = side  # a quaternion and its opposite are one rotation
            numbers = [*moved, sign * x, sign * y, sign * z, sign * w]
            rows.append(f"{start + i / 30 + side * 0.004:.6f} " + " ".join(f"{v:.12f}" for v in numbers))
    (root / "rgb.txt").write_text("\n".join(listed) + "\n")
    (root / "groundtruth.txt").write_text("\n".join(rows) + "\n")
    np.savetxt(root / "K.txt", synthetic.views[0].camera.K)
    return Capture(root, synthetic, synthetic.views, files)


def write_multiview(synthetic: Synthetic, root: Path, model: bool = True) -> Capture:
    """4DGaussians: cam01/frame_00001.jpg, ..., a COLMAP model of image1.jpg, ... in sparse_/, and poses_bounds_multipleview.npy."""
    views, files = [], []
    indices = sorted({view.camera_index for view in synthetic.views})
    for index in indices:
        for view in (view for view in synthetic.views if view.camera_index == index):
            views.append(view)
            files.append(f"cam{index + 1:02d}/frame_{view.time_index + 1:05d}.jpg")
            _save(root / files[-1], flatten(_truth(synthetic, view)), quality=95)
    first = {view.camera_index: view for view in reversed(views)}
    names = sorted(f"image{index + 1}" for index in indices)
    rows = [first[int(name[5:]) - 1] for name in names] if model else [first[index] for index in indices]
    np.save(root / "poses_bounds_multipleview.npy", np.stack([llff_row(view) for view in rows]))
    if model:
        (root / "sparse_").mkdir(parents=True)
        camera = first[0].camera
        lens = f"1 PINHOLE {camera.width} {camera.height} " + " ".join(f"{camera.K[p]:.17g}" for p in ((0, 0), (1, 1), (0, 2), (1, 2)))
        (root / "sparse_/cameras.txt").write_text(lens + "\n")
        lines = []
        for i, (name, view) in enumerate(zip(names, rows)):
            pose = [*_quaternion(view.camera.cam_from_world[:3, :3]), *view.camera.cam_from_world[:3, 3]]
            lines.append(f"{i + 1} " + " ".join(f"{v:.17g}" for v in pose) + f" 1 {name}.jpg\n\n")
        (root / "sparse_/images.txt").write_text("".join(lines))
    return Capture(root, synthetic, tuple(views), tuple(files))
