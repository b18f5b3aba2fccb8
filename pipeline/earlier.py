"""Finds an earlier result of a stage from which unchanged items, such as pairs of frames, can be reused."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from .errors import ArtifactError
from .files import canonical_json, digest_bytes
from .job import Job
from .keys import deciding
from .reusable import Earlier
from .stage import Given, Stage
from .storage.artifact import Artifact

if TYPE_CHECKING:
    from .storage.store import Store

RECENT = 8  # most recently used results per store that are considered; more would make planning slow in a store of thousands


def item_digests(job: Job, stage: Stage, inputs: Mapping[str, Artifact | None]) -> list[str]:
    """One digest for each of `Stage.item_parts`, given the inputs; [] for a stage whose result has no separate items."""
    if not stage.items:
        return []
    digests = job.capture_files if stage.reads_capture else {}
    given = Given(job.capture, job.capture.facts, job.settings[stage.name], inputs, digests)
    return [digest_bytes(canonical_json(parts))[:32] for parts in stage.item_parts(given)]


def find_earlier(job: Job, stage: Stage, parts: Mapping[str, Any], key: str, inputs: Mapping[str, Artifact | None]) -> Earlier | None:
    """The earlier result that shares the most items with the one to be made under ``key``. Candidates are the scene's last result and the
    most recently used ones. None if no candidate shares an item. The bytes of the result have not been checked."""
    if not stage.items:
        return None
    wanted: list[str] | None = None
    best: dict[int, int] = {}
    where: tuple[Store, str] | None = None
    for store, other in _candidates(job, stage, key):
        made = store.manifest(stage.name, other)
        items = _items(made, parts) if made is not None else []
        if not items:
            continue
        if wanted is None:
            try:
                wanted = item_digests(job, stage, inputs)
            except ArtifactError:  # an input is damaged; the run will detect that and ask again
                return None
        row_of = {digest: row for row, digest in enumerate(items)}
        rows = {number: row_of[digest] for number, digest in enumerate(wanted) if digest in row_of}
        if len(rows) > len(best):
            best, where = rows, (store, other)
        if len(best) == len(wanted):
            break
    if where is None or wanted is None:
        return None
    try:
        return Earlier(where[0].open(stage.name, where[1]), best, len(wanted))
    except ArtifactError:  # the result, or one of its files, has just been removed
        job.refused.add(where[0].path(stage.name, where[1]))
        return find_earlier(job, stage, parts, key, inputs)


def made_before(job: Job, stage: Stage, parts: Mapping[str, Any]) -> int:
    """How many items the scene's last result has that could be taken over, as far as code and settings tell."""
    record = job.records.read(stage.name) if stage.items else None
    made = job.store.manifest(stage.name, record["key"]) if record is not None else None
    return len(_items(made, parts)) if made is not None else 0


def _candidates(job: Job, stage: Stage, key: str) -> Iterator[tuple[Store, str]]:
    record = job.records.read(stage.name)
    last = [record["key"]] if record is not None else []
    for store in (job.store, *job.also):
        for other in dict.fromkeys([*last, *store.latest(stage.name, RECENT)]):
            if other != key and store.path(stage.name, other) not in job.refused:
                yield store, other


def _items(manifest: Mapping[str, Any], parts: Mapping[str, Any]) -> list[str]:
    """The items of a result; [] if it was made by different code, with different settings, or on another class of device."""
    provenance = manifest["provenance"]
    alike = _own(provenance.get("parts", {})) == _own(parts)
    return provenance.get("items", []) if alike else []


def _own(parts: Mapping[str, Any]) -> dict[str, Any]:
    """Key parts without the inputs and the capture, which the items' digests cover."""
    return {name: value for name, value in deciding(parts).items() if name not in ("inputs", "capture")}
