"""Captures as people bring them, made from those in SCENES: each function takes SCENES and an own folder, and returns the capture."""

from __future__ import annotations

import json
import shutil
import struct
import sys
import zipfile
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))  # for the scene factory
OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])


def colmap_folder(scenes: Path, folder: Path) -> Path:
    """balloon1 as a binary COLMAP model: its poses and lens, points by pycolmap from matched features with these poses."""
    import pycolmap

    data = json.loads((scenes / "balloon1/transforms.json").read_text())
    root, database = folder / "balloon1_colmap", folder / "database.db"
    shutil.copytree(scenes / "balloon1/images", root / "images")
    lens = [data[name] for name in ("fl_x", "fl_y", "cx", "cy", "k1", "k2", "p1", "p2")]
    reader = pycolmap.ImageReaderOptions(camera_model="OPENCV", camera_params=", ".join(map(str, lens)))
    pycolmap.extract_features(database, root / "images", camera_mode=pycolmap.CameraMode.SINGLE, reader_options=reader)
    pycolmap.match_exhaustive(database)
    with pycolmap.Database.open(database) as opened:
        (camera,), numbers = opened.read_all_cameras(), {image.name: image.image_id for image in opened.read_all_images()}
    known = pycolmap.Reconstruction()
    known.add_camera_with_trivial_rig(camera)
    for frame in data["frames"]:
        name = Path(frame["file_path"]).name
        pose = np.linalg.inv(np.array(frame["transform_matrix"]) @ OPENGL_FROM_OPENCV)
        cam_from_world = pycolmap.Rigid3d(pycolmap.Rotation3d(pose[:3, :3]), pose[:3, 3])
        known.add_image_with_trivial_frame(pycolmap.Image(name=name, camera_id=camera.camera_id, image_id=numbers[name]), cam_from_world)
    (root / "sparse/0").mkdir(parents=True)
    pycolmap.triangulate_points(known, database, root / "images", root / "sparse/0")
    return root


def archived(scenes: Path, folder: Path) -> Path:
    """The same in a .zip file, below a folder."""
    root = colmap_folder(scenes, folder)
    with zipfile.ZipFile(folder / "balloon1.zip", "w") as file:
        for path in sorted(root.rglob("*")):
            file.write(path, Path("balloon1") / path.relative_to(root))
    return folder / "balloon1.zip"


def rotated_video(scenes: Path, folder: Path) -> Path:
    """room.mp4 with a matrix in its track header that turns it clockwise by 90 degrees, as phones held upright write it."""
    data = bytearray((scenes / "room_video/room.mp4").read_bytes())
    at = data.index(b"tkhd") + 44
    if struct.unpack_from(">9i", data, at) != (1 << 16, 0, 0, 0, 1 << 16, 0, 0, 0, 1 << 30):
        raise ValueError("room.mp4: no identity where the matrix of its track is expected")
    struct.pack_into(">9i", data, at, 0, 1 << 16, 0, -1 << 16, 0, 0, 270 << 16, 0, 1 << 30)
    (folder / "upright.mp4").write_bytes(data)
    return folder / "upright.mp4"


def rig_of_two_sizes(scenes: Path, folder: Path) -> Path:
    """Every fourth time of stage as images with a transforms.json; cameras 2, 4 and 6 at half their size."""
    import av
    from PIL import Image

    root, frames = folder / "stage_two_sizes", []
    for camera, row in enumerate(np.load(scenes / "stage/poses_bounds.npy")[:, :15].reshape(-1, 3, 5)):
        down, right, back, centre, (height, width, focal) = row.T
        pose = np.eye(4)
        pose[:3] = np.stack([right, -down, back, centre], axis=1)
        with av.open(str(scenes / f"stage/cam{camera:02d}.mp4")) as video:
            pictures = [frame.to_image() for frame in video.decode(video=0)]
        scale = 0.5 if camera in (2, 4, 6) else 1.0
        size = round(width * scale), round(height * scale)
        lens = {"w": size[0], "h": size[1], "fl_x": focal * scale, "fl_y": focal * scale, "cx": width * scale / 2, "cy": height * scale / 2}
        for i in range(0, len(pictures), 4):
            name = f"images/cam{camera:02d}/{i:03d}.jpg"
            (root / name).parent.mkdir(parents=True, exist_ok=True)
            pictures[i].resize(size, Image.Resampling.BOX).save(root / name, quality=95)
            frames.append({"file_path": name, "time": i / (len(pictures) - 1), "transform_matrix": pose.tolist(), **lens})
    (root / "transforms.json").write_text(json.dumps({"frames": frames}, indent=1))
    return root


def nerfies(scenes: Path, folder: Path) -> Path:
    """A room of the tests' scene factory in the layout of Nerfies: 36 times of one moving camera, 320x240."""
    from factory import Options, make, write_nerfies

    options = Options(backdrop="room", rig="path", times=36, width=320, height=240, samples=2, fov_degrees=60.0)
    return write_nerfies(make(options), folder / "nerfies_room").root


def videos_alone(scenes: Path, folder: Path) -> Path:
    """Four of stage's videos and nothing else."""
    root = folder / "stage_four_videos"
    root.mkdir()
    for camera in (1, 3, 5, 7):
        shutil.copy(scenes / f"stage/cam{camera:02d}.mp4", root)
    return root
