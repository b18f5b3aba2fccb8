"""Rough run times for the plan and memory needs for batches, estimated before anything runs."""

from __future__ import annotations

from ..pipeline import Resources
from ..scene.motion.kinds import KINDS, choose
from .facts import Facts
from .shared.defaults import one_way

SECONDS_PER_MAP = 0.03  # of a depth map that is read and aligned, on two cores
SECONDS_PER_NETWORK_FRAME = 2.0  # a guess for a small network (25 M weights, 518 px) on two cores; none was timed
DENSER_ALONG_A_PATH = 1.5  # Gaussians for each pixel, see `auto_budget`
SECONDS_PER_FIRST_STEP = 0.009  # of a first training on very small images, on two cores

# Seeds, on two cores.
SECONDS_PER_MEGAPIXEL_MAP = 15.0  # of a picture in the plane sweep, which is at most `SWEPT_SIZE` px wide
SWEPT_SIZE = 320
SWEPT_ALONE, SWEPT_MOST = 32, 100  # pictures of one camera on its path, and most of several
SECONDS_PER_MOVING_TIME = 1.4  # of a rig, at each of `MOVING_TIMES`
MOVING_TIMES = 24
SECONDS_PER_MOVING_FRAME = 0.05  # of one camera
TRIANGULATED = 90  # most frames whose features are matched to triangulate points
TRIANGULATED_TIMES = 3  # of several cameras
SECONDS_PER_TRIANGULATED_FRAME = 0.3

# In GB of 1e9 bytes, fitted to the peak memory of the captures in benchmarks/results. None exceeds the estimate by more than a fifth.
GB_OF_PYTHON = 0.4  # with the libraries that read pictures
GB_OF_TORCH = 0.9
GB_OF_A_MATCHER = 0.13  # of each process that matches pictures
GB_PER_MEGAPIXEL = 0.012  # summed over all frames, whose pictures are cached
MOST_GB_OF_PICTURES = 5.0  # `scene.views.CACHE_BYTES`, and what is derived from the pictures
GB_PER_MEGAPIXEL_OF_A_VIEW = 1.0  # of the view being rendered, with its gradients
GB_PER_MEGAPIXEL_MEASURED = 1.8  # of the views that are being rendered and measured


def training_resources(facts: Facts, device: str, of_a_view: float = GB_PER_MEGAPIXEL_OF_A_VIEW) -> Resources:
    """Needs of a stage that renders with gradients or, with another need ``of_a_view`` (GB per megapixel), measures renders."""
    view = facts.width * facts.height / 1e6
    pictures = min(MOST_GB_OF_PICTURES, GB_PER_MEGAPIXEL * view * facts.frames)
    return Resources(memory_gb=GB_OF_TORCH + pictures + of_a_view * view, gpu=device == "cuda")


def picture_resources(facts: Facts, gb_per_megapixel: float, gb: float = GB_OF_PYTHON, gpu: bool = False) -> Resources:
    """Needs of a stage that works on a few pictures at a time."""
    return Resources(memory_gb=gb + gb_per_megapixel * facts.width * facts.height / 1e6, gpu=gpu)


def training_seconds(facts: Facts, iterations: int, kind: str, area: float = 1.0) -> float:
    """Seconds that ``iterations`` steps with a ``kind`` of motion take on two cores. area: mean area of the training images, as a share of
    the full images."""
    megapixels = facts.width * facts.height / 1e6 * (DENSER_ALONG_A_PATH if one_way(facts) else 1.0)
    return iterations * (KINDS[kind].step_seconds + KINDS[kind].megapixel_seconds * megapixels * area)


def first_training_seconds(iterations: int) -> float:
    """Seconds that ``iterations`` steps of a first training take on two cores."""
    return iterations * SECONDS_PER_FIRST_STEP


def depth_seconds(facts: Facts, network: bool) -> float:
    """Seconds that depth of single frames takes on two cores."""
    triangulating = facts.poses and not facts.points
    seconds = 1.0 + (_triangulating_seconds(facts) if triangulating else 0.0)
    frames = facts.splits.get("train", facts.frames)
    return seconds + (SECONDS_PER_NETWORK_FRAME * frames if network else SECONDS_PER_MAP * facts.depths)


def _triangulating_seconds(facts: Facts) -> float:
    matched = facts.frames if facts.cameras == 1 else facts.cameras * min(facts.times, TRIANGULATED_TIMES)
    return SECONDS_PER_TRIANGULATED_FRAME * min(matched, TRIANGULATED)


def seeds_seconds(facts: Facts, motion: str | None) -> float:
    """Seconds that placing seeds takes on two cores. motion: the setting of that name."""
    known_points = facts.points or not facts.poses  # of the capture, or of structure from motion
    seconds = 1.0
    if not known_points and not facts.alpha:
        seconds += 0.0 if facts.depths else _triangulating_seconds(facts)  # else `depth` has done it
    if facts.rig or one_way(facts) or (not known_points and not facts.alpha):
        several = facts.cameras if facts.cameras > 1 else facts.frames // facts.times
        maps = min(several, SWEPT_MOST) if facts.rig or facts.fixed_cameras else min(facts.frames, SWEPT_ALONE)
        shrink = min(1.0, SWEPT_SIZE / max(facts.width, facts.height, 1))
        seconds += SECONDS_PER_MEGAPIXEL_MAP * maps * facts.width * facts.height * shrink**2 / 1e6
    if facts.pairs and not facts.static and choose(motion, facts) != "nodes":
        alone = SECONDS_PER_MOVING_FRAME * facts.frames
        seconds += SECONDS_PER_MOVING_TIME * min(facts.times, MOVING_TIMES) if facts.cameras > 1 else alone
    return seconds
