"""`lens_groups`: which frames share a lens, by their camera, their size, and what the EXIF data of photos say."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from ...vision.images.focal_length import ExifLens, exif_lens

if TYPE_CHECKING:
    from ..shared.frameset import FrameSet

FEWEST = 3  # photos; fewer hardly determine a lens of their own
_NEAR = 1.05  # ratio of focal lengths up to which so few photos join another group


def lens_groups(frames: FrameSet) -> tuple[list[int], str | None]:
    """A number for each frame, equal for those that share a lens, and a line for people if EXIF data tell lenses apart.

    Pictures of different sizes count as different lenses, since they come from another camera or another zoom; and so do photos whose EXIF
    data state another camera or focal length. A camera matrix that is given holds for all photos."""
    shapes: list[tuple[int, ...]] = [(int(c),) for c in frames.camera]
    if frames.crop is not None:
        shapes = [(*shape, *crop) for shape, crop in zip(shapes, frames.crop.tolist(), strict=True)]
    lenses: list[ExifLens | None] = [None] * len(frames)
    if frames.files is not None and frames.K_hint is None:
        lenses = [exif_lens(frames.root / file) for file in frames.files]
    keys: list[Any] = [None] * len(frames)
    for shape in set(shapes):
        mine = [i for i, other in enumerate(shapes) if other == shape]
        for i, group in zip(mine, joined([lenses[i] for i in mine]), strict=True):
            keys[i] = (shape, group)
    number = {key: n for n, key in enumerate(dict.fromkeys(keys))}
    told = _told([group for _, group in number]) if len(number) > len(set(shapes)) else None
    counts = Counter(keys)
    if told is not None:
        told += ", ".join(f"{counts[key]} at {key[1] or 'an unknown focal length'}" for key in number)
    return [number[key] for key in keys], told


def joined(lenses: Sequence[ExifLens | None]) -> list[ExifLens | None]:
    """The group of each photo of one size, as the lens that stands for it. Fewer than `FEWEST` photos join the group of the same camera
    with the nearest focal length, if it is within 5 %. Those without EXIF data are one group, if they are enough, or all of the others are
    one group; then they belong to the largest."""
    counts = Counter(lens for lens in lenses if lens is not None)
    groups = {lens: [lens] for lens in counts}  # mean lens: its members
    unsure = sorted(counts, key=lambda lens: (counts[lens], lens))
    for lens in unsure:
        own = next(mean for mean, members in groups.items() if lens in members)
        if sum(counts[member] for member in groups[own]) >= FEWEST:
            continue
        near = [mean for mean in groups if mean != own and mean[1:] == own[1:] and _ratio(mean, own) <= _NEAR]
        if near:
            other = min(near, key=lambda mean: (_ratio(mean, own), mean))
            members = groups.pop(own) + groups.pop(other)
            total = sum(counts[member] for member in members)
            mean = own._replace(focal=sum(member.focal * counts[member] for member in members) / total)
            groups[mean] = groups.get(mean, []) + members
    size = {mean: sum(counts[member] for member in members) for mean, members in groups.items()}
    mean_of = {member: mean for mean, members in groups.items() for member in members}
    unknown = sum(lens is None for lens in lenses)
    alone = not groups or (len(groups) > 1 and unknown >= FEWEST)
    rest = None if alone else max(groups, key=lambda mean: (size[mean], mean))
    return [rest if lens is None else mean_of[lens] for lens in lenses]


def _ratio(a: ExifLens, b: ExifLens) -> float:
    return max(a.focal, b.focal) / min(a.focal, b.focal)


def _told(groups: Sequence[ExifLens | None]) -> str:
    return f"the EXIF data of the photos tell {len(groups)} lenses apart, and each gets intrinsics of its own: "
