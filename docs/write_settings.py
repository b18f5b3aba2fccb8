"""Writes docs/settings.md from the settings classes of the stages: `python docs/write_settings.py [--check]`.

--check changes nothing and exits 1 where the page is not what it would write.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

from e4dgs.pipeline import settings_by_name
from e4dgs.workflows.presets import PRESETS
from e4dgs.workflows.reconstruction import reconstruction
from pydantic.fields import FieldInfo

PAGE = Path(__file__).with_name("settings.md")
INTRODUCTION = """# Settings

<!-- Written by docs/write_settings.py from the settings classes. Do not edit. -->

Give a setting with `--set stage.KEY=VALUE`, as often as needed. `--set train.KEY=VALUE` sets it for all stages that train. A wrong name or
value is answered with the valid ones. Order: defaults, `--preset`, `--static`, `--format`, `--seed`, `--set`; the last one wins.

"none" as a default means that the program chooses, as the text says.
"""
HEAD = "| setting | default | values | meaning |\n|---|---|---|---|"
MAIN = (
    *("frames.format", "frames.static", "frames.holdout", "frames.background", "frames.max_size", "frames.max_frames", "frames.every"),
    *(
        "poses.matcher",
        "poses.camera_model",
        "poses.mapper",
        "depth.model",
        "flow.method",
        "flow.weights",
        "coarse.iterations",
        "coarse.effort",
    ),
    *("train.motion", "train.budget", "coarse.strategy", "hulls.budget", "fine.iterations", "train.seed", "train.sh_degree"),
    *("evaluate.splits", "evaluate.lpips_weights"),
)
BEYOND = 50_000  # upper limits from here on keep mistakes away, and are not worth a reader's time
ADVANCED = "These are right for nearly all captures. Older names are understood; a line says the new one."


def page() -> str:
    """The text of the page. Raises ValueError if the first table names a setting that does not exist."""
    classes = reconstruction().settings
    names = settings_by_name(classes)
    if missing := set(MAIN) - set(names):
        raise ValueError(f"no such setting: {', '.join(sorted(missing))}")
    parts = [INTRODUCTION, "## Presets\n", "| preset | what it sets |\n|---|---|", *presets(), ""]
    parts += ["## Settings that people change\n", HEAD, *(row(name, names[name][1]) for name in MAIN), ""]
    parts += ["## Advanced\n", ADVANCED]
    for group in dict.fromkeys(name.partition(".")[0] for name in [*(f"{stage}." for stage in classes), *names]):
        own = {name: field for name, (_, field) in names.items() if name.startswith(f"{group}.") and name not in MAIN}
        if own:
            of = next(stages for name, (stages, _) in names.items() if name in own)
            parts += [f"\n### {group}\n", *([f"Shared by {' and '.join(of)}.\n"] if len(of) > 1 else []), HEAD]
            parts += [row(name, field) for name, field in own.items()]
    return "\n".join(parts).rstrip() + "\n"


def presets() -> list[str]:
    chosen = {name: ", ".join(f"`{key}={value}`" for key, value in values.items()) for name, values in PRESETS.items()}
    return [f"| `{name}` | {text or 'nothing: the defaults'} |" for name, text in chosen.items()]


def row(key: str, field: FieldInfo) -> str:
    default = ",".join(field.default) if isinstance(field.default, tuple) else field.default
    return f"| `{key}` | {'none' if default is None else f'`{default}`'} | {values(field)} | {field.description} |"


def values(field: FieldInfo) -> str:
    """The choices, or the type and its range."""
    kinds = [kind for kind in flat(field.annotation) if kind is not type(None)]
    choices = [f"`{choice}`" for kind in kinds if get_origin(kind) is Literal for choice in get_args(kind)]
    if choices:
        return ", ".join(choices)
    if kinds == [Path, str]:
        return "folder or name"
    name = {bool: "yes, no", int: "integer", float: "number", Path: "file"}[kinds[0]]
    signs = {"ge": "≥", "gt": ">", "le": "≤", "lt": "<"}
    found = [(sign, getattr(limit, name)) for limit in field.metadata for name, sign in signs.items() if hasattr(limit, name)]
    limits = [f"{sign} {value:,.10g}" for sign, value in found if not (sign == "≤" and value >= BEYOND)]
    return " ".join([name, ", ".join(limits)]).strip()


def flat(annotation: Any) -> list[Any]:
    """The types that an annotation is made of, without unions and tuples around them."""
    if get_origin(annotation) is Literal or not get_args(annotation):
        return [annotation] if annotation is not ... else []
    return [kind for argument in get_args(annotation) for kind in flat(argument)]


if __name__ == "__main__":
    wanted = page()
    if "--check" in sys.argv[1:]:
        sys.exit(0 if PAGE.is_file() and PAGE.read_text() == wanted else f"{PAGE} is not up to date: python docs/write_settings.py")
    PAGE.write_text(wanted)
