"""Reading YAML that nobody has vouched for: plain values alone, within bounds before anything is made of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

MOST_BYTES = 4 * 2**20
DEEPEST = 50
MOST_VALUES = 1_000_000  # with every alias written out: ten lines of them can stand for 10^10 values


def read_yaml(file: Path) -> Any:
    """What ``file`` holds; None where it is empty. Raises ValueError for whatever is wrong with it, and OSError."""
    import yaml

    if file.stat().st_size > MOST_BYTES:
        raise ValueError(f"larger than {MOST_BYTES >> 20} MiB")
    text = file.read_text(encoding="utf-8")
    kind = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    loader = kind(text)
    try:
        depth = 0
        for event in yaml.parse(text, Loader=kind):  # libyaml's reader of values calls itself, and crashes where lists are very deep
            depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
            if depth > DEEPEST:
                raise ValueError(f"more than {DEEPEST} lists and mappings in one another")
        node = loader.get_single_node()
        if node is None:
            return None
        _count(node, {}, yaml.CollectionNode)
        return loader.construct_document(node)
    except (yaml.YAMLError, RecursionError, OverflowError) as error:
        raise ValueError(str(error)) from error
    finally:
        loader.dispose()


def _count(node: Any, known: dict[int, int | None], collection: type[Any]) -> int:
    """Values of ``node`` with every alias written out; None in ``known`` marks those that are being counted."""
    if not isinstance(node, collection):
        return 1
    if id(node) in known:
        count = known[id(node)]
        if count is None:
            raise ValueError("an alias of a list or mapping within itself")
        return count
    known[id(node)] = None
    parts = (part for entry in node.value for part in (entry if isinstance(entry, tuple) else (entry,)))
    known[id(node)] = count = 1 + sum(_count(part, known, collection) for part in parts)
    if count > MOST_VALUES:
        raise ValueError(f"more than {MOST_VALUES} values, with its aliases written out")
    return count
