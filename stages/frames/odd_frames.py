"""Says which frames of a film are no new moment of one scene, and what to do about them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ...vision.images.film import Film

_CUT = "ffmpeg -ss START -to END -i FILE -crf 12 NEW (in seconds)"


def told(films: Mapping[str, tuple[Film, Sequence[str]]]) -> tuple[str, ...]:
    """Lines for people. films: for each video, or the folder of pictures, by its name: what was seen, and the names of its frames."""
    repeated, plain, title, cuts = list[str](), list[str](), list[str](), list[str]()
    count = 0
    for film, names in films.values():
        found = film.findings()
        count += len(names)
        for kind, those in ((repeated, found.repeated), (plain, found.plain), (title, found.title), (cuts, found.cuts)):
            kind += [names[k] for k in those]
    lines = []
    if repeated:
        lines.append(
            f"{len(repeated)} of {count} frames repeat the one before (first {repeated[0]}), as where a rate was raised: what moves stops "
            "and jumps; take them out of a video with ffmpeg -i FILE -vf mpdecimate -fps_mode vfr NEW"
        )
    if plain:
        lines.append(f"{_these(plain, count)} of one colour (first {plain[0]}), as in a fade, and show nothing; leave them out: {_CUT}")
    if title:
        lines.append(f"{_these(title, count)} a still picture before or after a cut (first {title[0]}), as a title; leave it out: {_CUT}")
    if cuts:
        shown = ", ".join(cuts[:3]) + (f" and {len(cuts) - 3} more" if len(cuts) > 3 else "")
        lines.append(
            f"the view changes at once at {shown}, as at a cut to another shot, whose camera and moments differ: give each shot as a "
            f"capture of its own: {_CUT}"
        )
    return tuple(lines)


def _these(names: Sequence[str], count: int) -> str:
    return f"{len(names)} of {count} frames {'is' if len(names) == 1 else 'are'}"
