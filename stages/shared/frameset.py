"""`FrameSet`: the frames of a capture as numpy arrays, with poses from the files or from structure from motion. Imports no torch."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ...pipeline import Artifact
from ...vision.depth.files import read_depth
from ...vision.images import lenses, pictures
from ..frames.artifact import StoredFrames
from ..poses.artifact import StoredPoses

FEWEST_POINTS = 50  # of the capture or of structure from motion; fewer are not used
WHOLLY = 254  # of 255: value from which a pixel of a scaled or undistorted mask lies wholly inside
_MAPS_KEPT = 4  # cached maps take 8 bytes per pixel; one camera needs two, one for each direction


class FrameSet:
    """Frames of a capture: fields of the `frames` artifact, and pictures undistorted to the pinhole camera K.

    frames: the `frames` artifact. root: the capture's folder, for pictures in files. poses: the `poses` artifact, whose K,
    cam_from_world, distortion and points replace the capture's. chosen [n]: numbers of the frames that count, of a capture without
    ``poses``; all if not given.

    camera [F] int32; time, seconds [F] float64; split [F] uint8; next [F] int32 (-1 if none); K [F,3,3] float64 px and
    cam_from_world [F,4,4] float64 (OpenCV), None without poses; registered [F] bool; points [P,3] float64 and
    point_colors [P,3] uint8 or None; width, height px; background "white" | "black" | None; names.
    every_time: every so many-th time trains, and the pictures of the same cameras at the other times are test; 1 if all times train.
    watermark: [H,W] uint8, 255 where something stands still in all distorted pictures, such as a logo; None if nothing does.
    solved: whether the poses are our own, from structure from motion, so that the axes of the world have no meaning.
    origin: [3], the point of the files' world that is the origin of this one; None if nothing was moved.
    masked: whether some pixels do not count, so that `kept` may return a mask.
    enough_points: whether the capture or structure from motion gives enough points to begin with.
    files, upright: the image files, and whether they are rotated as their EXIF data ask; turns [F]: EXIF orientations by which pictures
    are turned after that; crop [F,4] px, or None if all pictures are shown whole.
    fixed_cameras: no camera moves, according to the files or the pictures. stands_still: nor is there more than one.
    train, val, test: indices [n] int64 of registered frames of each split (of all frames when there are no poses at all).
    number [F]: of each frame in the capture, which differs from its index here if only some were chosen.
    Pictures may be read from several threads at once; they are not cached here.
    """

    def __init__(self, frames: Artifact, root: Path, poses: Artifact | None = None, chosen: np.ndarray | None = None) -> None:
        stored, solved = StoredFrames.read(frames), None if poses is None else StoredPoses.read(poses)
        stored = stored if chosen is None else stored.only(chosen)
        self.number = np.arange(len(stored.camera)) if chosen is None else np.asarray(chosen)
        source, facts, self.solved = solved or stored, stored.facts, solved is not None
        self.root = Path(root)
        self.width, self.height = facts.width, facts.height
        self.background, self.alpha = stored.background, facts.alpha
        self.upright, self.untimed, self.every_time = facts.upright, facts.untimed, facts.every_time
        self.names, self.files = stored.names, stored.files
        self.mask_files, self.keep_files = stored.mask_files, stored.keep_files
        self.turns = stored.turns or [1] * len(self.names)
        self.keep_turns = stored.keep_turns or [1] * len(self.names)
        self.depth_files, self._confidence_files = stored.depth_files, stored.depth_confidence_files
        self.watermark = stored.watermark
        self.masked = self.keep_files is not None or self.watermark is not None
        self.K_hint = stored.K_hint
        self.origin = None if stored.origin is None else np.array(stored.origin)
        self.camera, self.time, self.seconds = stored.camera, stored.time, stored.seconds
        self.split, self.next, self.crop = stored.split, stored.next, stored.crop
        self._images = stored.images
        self.fixed_cameras = facts.fixed_cameras or (solved is not None and bool(solved.fixed_cameras))
        self.stands_still = self.fixed_cameras and facts.cameras == 1
        self.K, self.cam_from_world = source.K, source.cam_from_world
        self._distortion = np.zeros((len(self), 4)) if source.distortion is None else source.distortion
        self._lens_K = self.K if source.lens_K is None else source.lens_K
        self._fisheye = np.zeros(len(self), np.uint8) if source.fisheye is None else source.fisheye
        self.points, self.point_colors = source.points, source.point_colors
        self.enough_points = self.points is not None and len(self.points) >= FEWEST_POINTS
        if self.K is None or self.cam_from_world is None:
            self.registered = np.zeros(len(self), bool)
        else:
            finite = np.isfinite(self.cam_from_world).all((1, 2)) & np.isfinite(self.K).all((1, 2))
            self.registered = finite if source.registered is None else finite & source.registered
        usable = np.ones(len(self), bool) if self.cam_from_world is None else self.registered
        self.train, self.val, self.test = (np.flatnonzero(usable & (self.split == s)) for s in range(3))
        self._maps: dict[bytes, tuple[np.ndarray, ...]] = {}
        self._lock = threading.Lock()

    def __len__(self) -> int:
        return len(self.camera)

    def held(self, indices: np.ndarray) -> np.ndarray:
        """cam_from_world [n,4,4] of the frames ``indices`` as their cameras were held: turned back where pictures were turned (`turns`)."""
        assert self.cam_from_world is not None
        back = {1: np.eye(4), 6: pictures.CLOCKWISE.T, 8: pictures.CLOCKWISE}
        return np.stack([back[self.turns[i]] @ self.cam_from_world[i] for i in indices])

    def image(self, i: int) -> np.ndarray:
        """Frame i, undistorted to the pinhole camera K: uint8 [H,W,3], or [H,W,4] with straight alpha for captures with alpha."""
        picture = self.original(i)
        maps = self.undistortion(i)
        return picture if maps is None else pictures.undistort(picture, maps)

    def original(self, i: int) -> np.ndarray:
        """Frame i at the capture's size, still with its lens distortion. Structure from motion matches these pictures."""
        if self._images is not None:
            return self._images[i]
        assert self.files is not None
        stored = pictures.turned(pictures.read_picture(self.root, self.files[i], self.upright), self.turns[i])
        picture = pictures.resize(stored, self.width, self.height, None if self.crop is None else self.crop[i])
        if self.alpha and picture.shape[2] == 3:
            picture = np.concatenate([picture, np.full((*picture.shape[:2], 1), 255, np.uint8)], axis=2)
        elif not self.alpha and picture.shape[2] == 4:  # the capture's alpha is opaque
            picture = np.ascontiguousarray(picture[..., :3])
        return picture

    def composited(self, i: int) -> np.ndarray:
        """Frame i as uint8 [H,W,3] on the capture's background."""
        return pictures.composite(self.image(i), self.background)

    def both(self, i: int) -> tuple[np.ndarray, np.ndarray]:
        """Frame i on the capture's background, distorted and as `composited` returns it; the same array twice if there is no distortion."""
        stored, maps = self.original(i), self.undistortion(i)
        seen = pictures.composite(stored, self.background)
        return seen, seen if maps is None else pictures.composite(pictures.undistort(stored, maps), self.background)

    def picture_parts(self, i: int, digests: Mapping[str, str]) -> list[Any]:
        """Everything that determines the distorted picture of frame i, as JSON, without reading it. digests: BLAKE3 digest of each of the
        capture's files by name."""
        if self._images is not None:
            return [self._images.digest(i), self.width, self.height]
        assert self.files is not None
        part = None if self.crop is None else self.crop[i].tolist()
        shown = [self.width, self.height, part, self.upright, self.alpha, self.background]
        return [digests[Path(self.files[i]).as_posix()], *shown, *([self.turns[i]] if self.turns[i] != 1 else [])]

    def mask(self, i: int) -> np.ndarray | None:
        """Mask of the moving pixels of frame i, uint8 [H,W] (255 = moving), undistorted like the image; None if the capture has none."""
        name = self.mask_files[i] if self.mask_files is not None else None
        return None if name is None else self._fitted(i, pictures.read_mask(self.root, name))

    def kept(self, i: int) -> np.ndarray | None:
        """Pixels of frame i that count, bool [H,W], undistorted like the image; None if all do, since it has no mask and no watermark. A
        pixel that is partly excluded does not count."""
        name = self.keep_files[i] if self.keep_files is not None else None
        masks = [] if name is None else [self._fitted(i, pictures.read_keep(self.root, name, self.keep_turns[i]))]
        if self.watermark is not None:
            masks.append(self._undistorted(i, 255 - self.watermark))
        return None if not masks else np.asarray(np.logical_and.reduce([mask >= WHOLLY for mask in masks]))

    def depth(self, i: int) -> tuple[np.ndarray, np.ndarray] | None:
        """The capture's depth of frame i in its own unit, float32 [H,W], undistorted like the image and 0 where it is unknown, and the
        confidence in it as stored, which is 1 everywhere without a file of it; None if the frame has no depth."""
        name = self.depth_files[i] if self.depth_files is not None else None
        if name is None:
            return None
        sure = self._confidence_files[i] if self._confidence_files is not None else None
        shape = self.height, self.width
        depth = self._nearest(i, read_depth(self.root, name, shape))
        return depth, np.ones_like(depth) if sure is None else self._nearest(i, read_depth(self.root, sure, shape))

    def _nearest(self, i: int, values: np.ndarray) -> np.ndarray:
        """``values`` of frame i, of any size, made like its image, but never a mixture of two of them."""
        part, values = None, pictures.turned(values, self.turns[i])
        if self.crop is not None and self.files is not None:
            across, down = sorted(pictures.size_of(self.root, self.files[i]))
            if values.shape[1] > values.shape[0]:  # the size is that of the picture as stored
                across, down = down, across
            part = self.crop[i] / np.array([across, down, across, down])
        return pictures.nearest(values, self.width, self.height, part, self.undistortion(i))

    def _fitted(self, i: int, mask: np.ndarray) -> np.ndarray:
        """A mask of frame i, turned, scaled, cropped and undistorted like its image."""
        mask = pictures.turned(mask, self.turns[i])
        return self._undistorted(i, pictures.resize(mask, self.width, self.height, None if self.crop is None else self.crop[i]))

    def _undistorted(self, i: int, mask: np.ndarray) -> np.ndarray:
        maps = self.undistortion(i)
        return mask if maps is None else pictures.undistort(mask, maps)

    def bent(self, i: int) -> bool:
        """Whether the lens distorts frame i, so that the pinhole picture differs from the original; always False without a pose."""
        return self._lens_K is not None and bool(self.registered[i] and (self._distortion[i].any() or self._fisheye[i]))

    def straight_places(self, i: int) -> np.ndarray | None:
        """Position in the pinhole picture of each pixel of the distorted frame i: float32 [H,W,2] px, pixel centres at whole numbers; None
        if the frame is not `bent`."""
        places = self._of_lens(i, b"back", lambda *lens: (lenses.straight_places(*lens),))
        return None if places is None else places[0]

    def undistortion(self, i: int) -> tuple[np.ndarray, np.ndarray] | None:
        """Maps for `pictures.undistort`: position in the distorted picture of each pixel of the pinhole picture; None if not `bent`."""
        return self._of_lens(i, b"there", lenses.undistort_maps)  # type: ignore[return-value]

    def _of_lens(self, i: int, what: bytes, make: Callable[..., tuple[np.ndarray, ...]]) -> tuple[np.ndarray, ...] | None:
        """Result of ``make`` for the lens of frame i, cached since other frames share the lens; None if the frame is not `bent`."""
        if self.K is None or self._lens_K is None or not self.bent(i):
            return None
        lens_K, terms, fisheye = self._lens_K[i], self._distortion[i], bool(self._fisheye[i])
        key = what + self.K[i].tobytes() + lens_K.tobytes() + terms.tobytes() + bytes([fisheye])
        with self._lock:
            maps = self._maps.get(key)
        if maps is None:
            maps = make(self.K[i], terms, self.width, self.height, lens_K, fisheye)
            with self._lock:
                if len(self._maps) >= _MAPS_KEPT:
                    self._maps.pop(next(iter(self._maps)))
                self._maps[key] = maps
        return maps
