"""Writes docs/settings.md from the settings classes of the stages: `python docs/write_settings.py [--check]`.

--check changes nothing and exits 1 where the page is not what it would write.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

from e4dgs.scene.settings import RefinementSettings
from e4dgs.workflows.presets import PRESETS
from e4dgs.workflows.reconstruction import reconstruction
from pydantic.fields import FieldInfo

PAGE = Path(__file__).with_name("settings.md")
INTRODUCTION = """# Settings

<!-- Written by docs/write_settings.py from the settings classes. Do not edit. -->

Give a setting with `--set stage.key=value`, as often as needed. A wrong key or value is answered with the valid ones. Order: defaults, then
`--preset`, then `--static` and `--format`, then `--set`; the last one wins.

"none" as a default means that the program chooses, as the text says. Changing a setting of a stage reruns that stage and those
that read its result.
"""
HEAD = "| setting | default | values | meaning |\n|---|---|---|---|"
SHARED = "Both training stages, `coarse` and `fine`, have these. They are set for each stage by itself, for example `--set fine.seed=3`."


def page() -> str:
    stages = reconstruction().stages
    both = RefinementSettings.model_fields
    parts = [INTRODUCTION, "## Presets\n", "| preset | what it sets |\n|---|---|", *presets(), ""]
    for name, stage in stages.items():
        fields: dict[str, FieldInfo] = stage.settings.model_fields
        trained = issubclass(stage.settings, RefinementSettings)
        own = {key: field for key, field in fields.items() if not trained or key not in both or differs(field, both[key])}
        parts += [f"## {name}\n", HEAD, *(row(f"{name}.{key}", field) for key, field in own.items()), ""]
        if name == "fine":
            parts += ["## coarse and fine\n", SHARED + "\n", HEAD]
            parts += [row(key, field) for key, field in both.items() if key != "iterations"] + [""]
    return "\n".join(parts).rstrip() + "\n"


def presets() -> list[str]:
    chosen = {name: ", ".join(f"`{key}={value}`" for key, value in values.items()) for name, values in PRESETS.items()}
    return [f"| `{name}` | {text or 'nothing: the defaults'} |" for name, text in chosen.items()]


def differs(field: FieldInfo, other: FieldInfo) -> bool:
    return (field.default, field.description) != (other.default, other.description)


def row(key: str, field: FieldInfo) -> str:
    default = ",".join(field.default) if isinstance(field.default, tuple) else field.default
    return f"| `{key}` | {'none' if default is None else f'`{default}`'} | {values(field)} | {field.description} |"


def values(field: FieldInfo) -> str:
    """The choices, or the type and its range."""
    kinds = [kind for kind in flat(field.annotation) if kind is not type(None)]
    choices = [f"`{choice}`" for kind in kinds if get_origin(kind) is Literal for choice in get_args(kind)]
    if choices:
        return ", ".join(choices)
    name = {bool: "`True`, `False`", int: "integer", float: "number", Path: "file"}[kinds[0]]
    words = {"ge": "at least", "gt": "above", "le": "at most", "lt": "below"}
    limits = [f"{word} {getattr(limit, name):,.10g}" for limit in field.metadata for name, word in words.items() if hasattr(limit, name)]
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
