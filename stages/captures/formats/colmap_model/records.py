"""What one record of a COLMAP file holds, and the limits that hold for all of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ... import checks
from ...posed.rotations import rotation

MOST_IMAGES = 1_000_000
# COLMAP's camera models in the order of their ids. For the supported models: whether fx and fy are one value, and how many distortion
# terms follow cx, cy. The terms are OpenCV's in OpenCV's order. Models with fisheye terms are listed separately.
MODELS = (
    *("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "OPENCV_FISHEYE", "FULL_OPENCV", "FOV", "SIMPLE_RADIAL_FISHEYE"),
    *("RADIAL_FISHEYE", "THIN_PRISM_FISHEYE", "RAD_TAN_THIN_PRISM_FISHEYE", "SIMPLE_DIVISION", "DIVISION", "SIMPLE_FISHEYE", "FISHEYE"),
)
_BROWN = {"SIMPLE_PINHOLE": (True, 0), "PINHOLE": (False, 0), "SIMPLE_RADIAL": (True, 1), "RADIAL": (True, 2), "OPENCV": (False, 4)}
_FISHEYE = {"SIMPLE_FISHEYE": (True, 0), "FISHEYE": (False, 0), "SIMPLE_RADIAL_FISHEYE": (True, 1), "RADIAL_FISHEYE": (True, 2)}
LAYOUT = {**_BROWN, "FULL_OPENCV": (False, 8), **_FISHEYE, "OPENCV_FISHEYE": (False, 4)}

CameraRecord = tuple[str, float, float, list[float]]  # model, width, height, parameters


@dataclass(frozen=True)
class ImageRecord:
    name: str
    camera: int
    pose: np.ndarray  # [7] qw qx qy qz tx ty tz, cam_from_world
    number: int  # its id, by which frames name it

    def cam_from_world(self, where: str) -> np.ndarray:
        """[4,4]. Raises CaptureError, which begins with ``where``."""
        matrix = np.eye(4)
        matrix[:3, :3] = rotation(self.pose[:4], where)
        matrix[:3, 3] = self.pose[4:7]
        return checks.rigid(matrix, where)


@dataclass(frozen=True)
class FrameRecord:
    """What the cameras of a rig took at one time (COLMAP 3.12 and later). images: the number of each one's image, by the camera's."""

    number: int
    rig: int
    images: dict[int, int]


def refusal(model: str) -> str:
    return f"model {model[:40]} is not supported ({', '.join(LAYOUT)} are); undistort the images with colmap image_undistorter first"


def too_many_points(count: str, most: int) -> str:
    """What follows the file's name. count: how many points it has."""
    return (
        f"it has {count} points, and at most {most} are read; thin them out, or remove the file, and the points are triangulated from the "
        "pictures"
    )
