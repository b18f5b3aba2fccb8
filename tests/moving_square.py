"""A square that slides before a wall, seen by one camera that slides too: its views, its exact flow and masks, points of the wall."""

from pathlib import Path

import numpy as np
from e4dgs.pipeline import Artifact, ArtifactWriter
from e4dgs.scene.views import Views
from e4dgs.stages.flow.artifact import StoredFlow

WIDTH, HEIGHT, FRAMES, FOCAL = 160, 96, 9, 100.0
WALL, NEAR = 8.0, 4.0  # world units to the wall and to the square before it
CAMERA, SQUARE = 0.1, -0.2  # world units a frame to the right


def pose(k: int) -> np.ndarray:
    cam_from_world = np.eye(4)
    cam_from_world[0, 3] = -CAMERA * k
    return cam_from_world


def views(times: int = FRAMES) -> Views:
    K = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]])
    return Views(
        K=np.tile(K, (times, 1, 1)),
        cam_from_world=np.stack([pose(k) for k in range(times)]),
        time=np.linspace(0, 1, times),
        camera=np.zeros(times, int),
        next=np.array([*range(1, times), -1]),
        train=np.arange(times),
        width=WIDTH,
        height=HEIGHT,
        load=lambda i: np.full((HEIGHT, WIDTH, 3), 10 * i + 5, np.uint8),
    )


def left_edge(k: int) -> float:
    """Of the square in frame ``k``, px; it is 40 px wide and moves by a whole number of them."""
    return 90 + FOCAL / NEAR * (SQUARE - CAMERA) * k


def flow_of(folder: Path, gap: int | None = None) -> StoredFlow:
    """Exact flow and masks of the square before the wall; without the pair that begins at frame ``gap``."""
    masks = np.zeros((FRAMES, HEIGHT, WIDTH), np.uint8)
    for k in range(FRAMES):
        x = round(left_edge(k))
        masks[k, 30:70, x : x + 40] = 255
    step = {255: FOCAL / NEAR * (SQUARE - CAMERA), 0: -FOCAL / WALL * CAMERA}
    pairs = [k for k in range(FRAMES - 1) if k != gap]
    forward, backward = (np.zeros((len(pairs), HEIGHT, WIDTH, 2), np.float16) for _ in range(2))
    for p, k in enumerate(pairs):
        for value, u in step.items():
            forward[p, masks[k] == value, 0], backward[p, masks[k + 1] == value, 0] = u, -u
    folder.mkdir()
    out = ArtifactWriter(folder)
    out.write("pair", np.array([(k, k + 1) for k in pairs], np.int32))
    out.write("forward", forward)
    out.write("backward", backward)
    out.write("confidence", np.full((len(pairs), HEIGHT, WIDTH), 255, np.uint8))
    out.write("moving", masks)
    out.finish({})
    return StoredFlow(Artifact(folder))


def wall(count: int = 4000) -> np.ndarray:
    rng = np.random.default_rng(0)
    return np.stack([rng.uniform(-8, 8, count), rng.uniform(-5, 5, count), np.full(count, WALL)], 1)
