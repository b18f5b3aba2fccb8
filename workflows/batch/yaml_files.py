"""Reads untrusted YAML: only plain values, and sizes are checked before any values are built."""

from __future__ import annotations

from pathlib import Path
from typing import Any

MOST_BYTES = 4 * 2**20
DEEPEST = 50
MOST_VALUES = 1_000_000  # with every alias expanded: ten lines of aliases can stand for 10^10 values


def read_yaml(file: Path) -> Any:
    """The content of ``file``; None if it is empty. Raises ValueError if anything is wrong with it, or OSError."""
    import yaml

    if file.stat().st_size > MOST_BYTES:
        raise ValueError(f"larger than {MOST_BYTES >> 20} MiB")
    text = file.read_text(encoding="utf-8")
    kind = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    loader = kind(text)
    try:
        depth = 0
        for event in yaml.parse(text, Loader=kind):  # libyaml builds values recursively and crashes on very deep lists
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
    """Number of values in ``node`` with every alias expanded; None in ``known`` marks nodes that are being counted."""
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
