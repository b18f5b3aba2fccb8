"""Rough run times for the plan and memory needs for batches, estimated before anything runs."""

from __future__ import annotations

from ..pipeline import Resources
from ..scene.motion.kinds import KINDS
from .facts import Facts

SECONDS_PER_FIRST_STEP = 0.01  # of a first training on very small images, on two cores

# In GB of 1e9 bytes, fitted to the peak memory of the captures in benchmarks/results. None exceeds the estimate by more than a fifth.
GB_OF_TORCH = 0.7
GB_PER_MEGAPIXEL = 0.008  # summed over all frames, whose pictures are cached
MOST_GB_OF_PICTURES = 5.0  # `scene.views.CACHE_BYTES`, and what is derived from the pictures
GB_PER_MEGAPIXEL_OF_A_VIEW = 1.0  # of the view being rendered, with its gradients


def training_resources(facts: Facts, device: str) -> Resources:
    """Needs of a stage that renders with gradients or measures renders."""
    view = facts.width * facts.height / 1e6
    pictures = min(MOST_GB_OF_PICTURES, GB_PER_MEGAPIXEL * view * facts.frames)
    return Resources(memory_gb=GB_OF_TORCH + pictures + GB_PER_MEGAPIXEL_OF_A_VIEW * view, gpu=device == "cuda")


def picture_resources(facts: Facts, gb_per_megapixel: float, gb: float = 0.3, gpu: bool = False) -> Resources:
    """Needs of a stage that works on a few pictures at a time."""
    return Resources(memory_gb=gb + gb_per_megapixel * facts.width * facts.height / 1e6, gpu=gpu)


def training_seconds(facts: Facts, iterations: int, kind: str, area: float = 1.0) -> float:
    """Seconds that ``iterations`` steps with a ``kind`` of motion take on two cores. area: mean area of the training images, as a share of
    the full images."""
    megapixels = facts.width * facts.height / 1e6
    return iterations * (KINDS[kind].step_seconds + KINDS[kind].megapixel_seconds * megapixels * area)


def first_training_seconds(iterations: int) -> float:
    """Seconds that ``iterations`` steps of a first training take on two cores."""
    return iterations * SECONDS_PER_FIRST_STEP
