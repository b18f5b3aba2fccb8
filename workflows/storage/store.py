"""`e4dgs store list`, `show`, `diff`, `pin`, `unpin`: what is in a workspace's store, how it was made, and how two results differ."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from ...pipeline import Artifact, ArtifactError, Pins, SettingsError, Store, counted, duration, say
from ...pipeline.files import sizes
from ...pipeline.names import composed
from ...pipeline.records import differences
from ..machine.terminal import make_console
from ..machine.writable import writing_to
from ..options import Debug, Workspace
from ..reconstruction import reconstruction
from ..results import in_workspace
from ..session import DEFAULT_WORKSPACE
from ..which_scene import scene_of
from .amounts import age, megabytes
from .stored import Stored, every, find, opened, users
from .table import fitted

SHORT = 12  # digits of a key or digest that are shown in tables
TITLES = ("stage", "key", "size", "took", "memory", "made", "scenes", "pins")

Json = Annotated[bool, typer.Option("--json", help="As JSON.")]


def list_(
    stage: Annotated[str | None, typer.Argument(metavar="[STAGE]", help="Only results of this stage.")] = None,
    workspace: Workspace = DEFAULT_WORKSPACE,
    as_json: Json = False,
    debug: Debug = False,
) -> None:
    """List every result in the store: stage, key, size, date, time and memory it took, the scenes whose last run used it, and pins."""
    store = opened(workspace)
    found = [stored for stored in every(workspace.resolve()) if stage in (None, stored.stage)]
    if stage is not None and not found and stage not in (names := reconstruction().stages):
        raise SettingsError(f"there is no stage {stage!r}; give one of: {', '.join(names)}")
    if as_json:
        print(json.dumps([_facts(stored) for stored in found], indent=2, ensure_ascii=False))
        return
    pinned = Pins(store).results()
    rows = []
    for stored in found:
        facts = _facts(stored)
        row = {"stage": stored.stage, "key": stored.key[:SHORT], "size": megabytes(stored.size), "made": facts["made"] or ""}
        row |= {"took": duration(facts["seconds"] or 0.0), "memory": f"{facts['peak_rss_mb'] or 0.0:.0f} MB", "age": age(row["made"])}
        row |= {"scenes": ", ".join(stored.scenes), "pins": ", ".join(pinned.get((stored.stage, stored.key), ()))}
        rows.append(row)
    console = make_console()
    table, missing = fitted(rows, TITLES, console.width)
    console.print(table)
    say(f"{counted(len(found), 'result')}, {megabytes(sum(stored.size for stored in found))}")
    if missing:
        say(f"not shown in {console.width} columns: {', '.join(missing)}; --json has them")


def show_result(
    words: Annotated[
        list[str], typer.Argument(metavar="KEY|SCENE STAGE", help="A key, its first digits, or a scene or capture and a stage.")
    ],
    workspace: Workspace = DEFAULT_WORKSPACE,
    as_json: Json = False,
    debug: Debug = False,
) -> None:
    """Show how a result was made: code, settings, inputs, versions; time, memory and size; its arrays, and what the stage said."""
    stored = find(workspace.resolve(), *words)
    if as_json:
        print(json.dumps(_facts(stored) | {"provenance": stored.manifest["provenance"]}, indent=2, ensure_ascii=False))
        return
    facts, parts = _facts(stored), stored.made("parts", {})
    say(stored.name)
    libraries = ", ".join(f"{name} {version}" for name, version in stored.made("libraries", {}).items())
    took = f"{duration(facts['seconds'] or 0.0)}, at most {facts['peak_rss_mb'] or 0.0:.0f} MB of memory, on {facts['device']}"
    rows = [
        ("scenes", ", ".join(stored.scenes) or "none: no scene's last run used it"),
        ("made", f"{facts['made'] or 'at an unknown time'} in {took}"),
        ("size", f"{megabytes(stored.size)} in {counted(len(sizes(stored.path)), 'file')}, content {facts['digest'][:SHORT]}"),
        ("made by", f"{_code(parts)}, e4dgs {stored.made('code_version') or 'unknown'}; {libraries}"),
    ]
    try:
        Artifact(stored.path)
    except ArtifactError as error:
        rows.append(("damaged", str(error)))
    if "capture" in parts:
        rows.append(("capture", f"content {str(parts['capture'])[:SHORT]}"))
    if stored.made("earlier"):
        rows.append(("earlier", f"partly reused from {stored.stage}/{stored.made('earlier')[:SHORT]}"))
    sources = _sources(workspace.resolve(), parts.get("inputs", {}))
    rows += [(f"input {name}", source) for name, source in sources.items()]
    rows += [(f"{stored.stage}.{name}", json.dumps(value, ensure_ascii=False)) for name, value in parts.get("settings", {}).items()]
    rows += [(f"array {name}", f"{shape} {dtype} {unit}".rstrip()) for name, shape, dtype, unit in stored.arrays()]
    say(*(f"  {name}: {value}" for name, value in rows), *(f"  said: {line}" for line in stored.made("log", [])))


def diff(
    a: Annotated[str, typer.Argument(metavar="A", help="KEY, STAGE/KEY or SCENE/STAGE.")],
    b: Annotated[str, typer.Argument(metavar="B")],
    workspace: Workspace = DEFAULT_WORKSPACE,
    debug: Debug = False,
) -> None:
    """Say in which code, settings, inputs and versions two results of one stage differ, and whether their content does."""
    one, two = find(workspace.resolve(), a), find(workspace.resolve(), b)
    if one.stage != two.stage:
        raise SettingsError(f"{a} and {b}: these are results of {one.stage} and of {two.stage}; give two of one stage")
    say(f"{one.name} -> {two.name}")
    say(*(f"  {line}" for line in _causes(workspace.resolve(), one, two)))
    same = one.manifest["digest"] == two.manifest["digest"]
    say("the content is the same" if same else "the content differs")


def pin(scene: Annotated[str, typer.Argument(metavar="SCENE")], workspace: Workspace = DEFAULT_WORKSPACE, debug: Debug = False) -> None:
    """Keep what a scene's last run used, whatever runs later: `gc` leaves it until it is unpinned."""
    scene = scene_of(Path(scene), workspace.resolve()) or scene
    results = [result for result, scenes in users(workspace.resolve()).items() if scene in scenes]
    if not results:
        known = sorted({name for scenes in users(workspace.resolve()).values() for name in scenes})
        raise SettingsError(f"{scene}: {workspace} has no results of such a scene; scenes: {', '.join(known) or 'none'}")
    with writing_to(workspace.resolve()):
        pinned = Pins(Store(workspace.resolve() / "store")).add(scene, sorted(results))
    say(f"{scene}: {counted(len(pinned), 'result is', 'results are')} pinned")


def unpin(scene: Annotated[str, typer.Argument(metavar="SCENE")], workspace: Workspace = DEFAULT_WORKSPACE, debug: Debug = False) -> None:
    """Let go of what `pin` keeps."""
    scene, pins = composed(scene), Pins(Store(workspace.resolve() / "store"))
    if scene not in pins.names():
        raise SettingsError(f"{scene}: there is no such pin; pins: {', '.join(pins.names()) or 'none'}")
    with writing_to(workspace.resolve()):
        pins.remove(scene)
    say(f"{scene}: no longer pinned")


def _causes(workspace: Path, one: Stored, two: Stored) -> list[str]:
    before, after = one.made("parts", {}), two.made("parts", {})
    lines = differences(before, after)
    old, new = (_sources(workspace, parts.get("inputs", {})) for parts in (before, after))
    for k, line in enumerate(lines):
        name = line.removeprefix("input ").removesuffix(" changed")
        if f"input {name} changed" == line and "/" in old[name] and "/" in new[name]:
            lines[k] = f"{line}: e4dgs store diff {old[name]} {new[name]}{in_workspace(workspace)}"
    for field in ("device", "code_version"):
        if field not in before and one.made(field) != two.made(field):
            lines.append(f"{field.replace('_', ' ')}: {one.made(field)} -> {two.made(field)}")
    old_libraries, new_libraries = one.made("libraries", {}), two.made("libraries", {})
    for name in sorted({*old_libraries, *new_libraries}):
        if old_libraries.get(name) != new_libraries.get(name):
            lines.append(f"{name}: {old_libraries.get(name)} -> {new_libraries.get(name)}")
    for what, shown in (("seconds", duration), ("peak_rss_mb", lambda megabytes: f"{megabytes:.0f} MB")):
        values = [stored.made(what, 0.0) for stored in (one, two)]
        lines.append(f"{'took' if what == 'seconds' else 'memory'}: {shown(values[0])} -> {shown(values[1])}")
    lines.append(f"size: {megabytes(one.size)} -> {megabytes(two.size)}")
    return lines


def _sources(workspace: Path, inputs: Mapping[str, str | None]) -> dict[str, str]:
    """Input -> ``STAGE/KEY`` of the result with that content, or its digest if the store no longer has it."""
    if not inputs:
        return {}
    stored = {(other.stage, other.manifest["digest"]): other.name for other in every(workspace) if other.stage in inputs}
    return {
        name: "skipped" if digest is None else stored.get((name, digest), f"content {digest[:SHORT]}, no longer in the store")
        for name, digest in inputs.items()
    }


def _code(parts: Mapping[str, Any]) -> str:
    """The code that made a result, or its version number for results made before keys included the code."""
    if "code" not in parts:
        return f"version {parts.get('version')}"
    return f"code {parts['code']['digest'][:SHORT]} of {counted(len(parts['code']['files']), 'file')}"


def _facts(stored: Stored) -> dict[str, Any]:
    facts: dict[str, Any] = {"stage": stored.stage, "key": stored.key, "scenes": list(stored.scenes), "bytes": stored.size}
    facts["digest"] = stored.manifest["digest"]
    return facts | {field: stored.made(field) for field in ("made", "seconds", "peak_rss_mb", "device")}
