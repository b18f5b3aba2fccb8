"""The report of a scene: one self-contained HTML file with pictures, curves and tables, which opens anywhere and needs no network.

Imports neither torch nor a plotting library, so that a fully cached run can write it quickly.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ...pipeline import Artifact, duration
from ..evaluate.artifact import StoredPictures, read_movies
from ..evaluate.pictures.edge_colours import KEYS
from .curves import in_order, is_number, over_time, training_curves
from .plot import Plot, svg

TEMPLATE = Path(__file__).with_name("report.html.jinja")
TRAINED = ("coarse", "fine")
FLOW_KINDS = (
    ("frame", "ground truth"),
    ("measured", "measured flow"),
    ("rendered", "rendered flow"),
    ("edges", "edges"),
    ("moving", "moving pixels"),
)
MEASURED_AS = ("metrics", "colours", "moving", "flicker")  # entries of the protocol that are sentences, shown in small print
VIEW_COLUMNS = (("truth", "ground truth"), ("render", "render"), ("error", "error × 4"), ("edges", "edges"), ("depth", "depth"))
KINDS = (("gaussians", "Gaussians"), ("convexes", "convexes"))
NEAR_TO_FAR = "#7a0403,#d23105,#fb8122,#ecd13a,#a4fc3c,#32f298,#28bceb,#466be3,#30123b"  # of pictures of depth: turbo, from its end
VIEWS_OPEN = 6  # the others are folded away
DATA, MOVIE = "data:image/png;base64,", "data:video/mp4;base64,"
MOVIES = (("over_time", "held-out views in order of time: ground truth, render"), ("turntable", "a turn about the scene"))
FLICKER = (  # key, title, unit
    ("static", "flicker where nothing moves", "levels"),
    ("edges", "flicker at edges", "levels"),
    ("warped", "flicker along the motion", "levels"),
    ("flow", "flow differs from the truth's by", "px"),
)
HEADLINES = (  # key, title, unit, decimals
    ("psnr", "PSNR", "dB", 2),
    ("edge_psnr", "PSNR near edges", "dB", 2),
    ("ssim", "SSIM", "", 4),
    ("lpips", "LPIPS", "", 4),
    ("psnr_affine", "PSNR after colour fit", "dB", 2),
    ("ssim_affine", "SSIM after colour fit", "", 4),
    ("psnr_moving", "PSNR of moving pixels", "dB", 2),
    ("psnr_static", "PSNR of static pixels", "dB", 2),
    ("psnr_foreground", "PSNR where alpha is not 0", "dB", 2),
    ("psnr_other_background", "PSNR on the other background", "dB", 2),
)


def render_report(
    scene_name: str,
    evaluate: Artifact,
    infos: Mapping[str, Mapping[str, Any]],
    plan_rows: Sequence[Mapping[str, Any]],
    metrics: Mapping[str, Any],
    seeds: bytes | None = None,
    command: str | None = None,
    player: str | None = None,
) -> str:
    """The page as HTML text.

    evaluate: artifact of `evaluate`, for the pictures. infos: for each stage, attrs and info in one dict (or under "attrs" and "info"),
    including `training` of `coarse` and `fine`. plan_rows: `stage`, `state`, `reason`, `seconds`, `peak_rss_mb`. metrics: the content of
    metrics.json. seeds: a PNG of the seeds. command: reproduces the run. player: the
    HTML of the web player's page. If a key is missing, its part of the page is left out. All text is
    escaped.
    """
    from jinja2 import Environment
    from markupsafe import Markup

    def drawn(plots: Sequence[Plot]) -> list[tuple[Plot, Markup]]:
        return [(plot, Markup(text)) for plot in plots if (text := svg(plot))]

    flat = {name: flatten(info) for name, info in infos.items()}
    training = {name: flat[name].get("training") or {} for name in TRAINED if name in flat}
    stored = StoredPictures.read(evaluate)
    pictures = {name: DATA + base64.b64encode(data).decode() for name, data in stored.files.items()}
    environment = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
    environment.filters |= {"number": number, "duration": lambda s: duration(float(s)) if is_number(s) else "–"}
    protocol = metrics.get("protocol") or {}
    return environment.from_string(TEMPLATE.read_text(encoding="utf-8")).render(
        scene=scene_name,
        protocol={key: value for key, value in protocol.items() if key not in ("notes", *MEASURED_AS)},
        measured_as=[protocol[key] for key in MEASURED_AS if protocol.get(key)],
        notes=protocol.get("notes") or [],
        headlines=headlines(metrics),
        facts=facts(metrics),
        views=[v for v in worst_first(stored.views) if f"{v['stem']}/render" in pictures],
        views_open=VIEWS_OPEN,
        columns=[column for column in VIEW_COLUMNS if any(name.endswith(f"/{column[0]}") for name in pictures)],
        edge_keys=KEYS,
        depth_colours=NEAR_TO_FAR,
        command=command,
        over_time=drawn(over_time(metrics)),
        no_flicker="flicker" in metrics and metrics["flicker"] is None,
        strip=_strip(stored.strip, pictures),
        flow=_flow(stored.flow, pictures),
        pictures=pictures,
        movies=_movies(evaluate),
        player=player,
        seeds=None if seeds is None else DATA + base64.b64encode(seeds).decode(),
        plots=drawn(training_curves(training)),
        splits=tables(metrics),
        training={name: {k: v for k, v in log.items() if not isinstance(v, list)} for name, log in training.items() if log},
        plan=plan_rows,
        total=total_of(plan_rows),
        logs={name: list(info.get("log") or []) for name, info in flat.items() if info.get("log")},
        settings=settings_of(flat, evaluate),
        provenance=_provenance(evaluate),
    )


def flatten(info: Mapping[str, Any]) -> dict[str, Any]:
    """A stage's attrs and info in one dict, whether they were nested or not."""
    nested = {key: info[key] for key in ("attrs", "info") if isinstance(info.get(key), Mapping)}
    return {**{k: v for k, v in info.items() if k not in nested}, **nested.get("attrs", {}), **nested.get("info", {})}


def number(value: Any, decimals: int = 2) -> str:
    """A number formatted for people; an en dash if it is not a number."""
    if not is_number(value):
        return "–"
    return f"{value:,}" if isinstance(value, int) else f"{value:.{decimals}f}"


def headlines(metrics: Mapping[str, Any]) -> list[dict[str, Any]]:
    """For each split, test first, its metrics with title, text, unit and hint."""
    result = []
    for split, values in in_order(metrics.get("splits") or {}).items():
        tiles = []
        for key, title, unit, decimals in HEADLINES:
            if key in values:
                hint = values.get("lpips_reason", "") if key == "lpips" and values[key] is None else ""
                tiles.append({"title": title, "text": number(values[key], decimals), "unit": unit, "hint": hint})
        result.append({"split": split, "views": len(values.get("per_view") or []), "tiles": tiles})
    return result


def facts(metrics: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Training time, flicker, speed and size."""
    primitives = metrics.get("primitives") or {}
    found = []
    if is_number(metrics.get("train_seconds")):
        found.append(("trained in", duration(float(metrics["train_seconds"]))))
    flicker = metrics.get("flicker") or {}
    for name, title, unit in FLICKER:
        if is_number(flicker.get(name)):
            found.append((title, f"{flicker[name]:.2f} {unit}"))
    if is_number(metrics.get("render_fps")):
        found.append(("renders at", f"{metrics['render_fps']:.3g} frames/s"))
    found += [(title, number(primitives[key])) for key, title in KINDS if key in primitives]
    return found


def tables(metrics: Mapping[str, Any]) -> list[dict[str, Any]]:
    """For each split, the columns that have values, and one row per view."""
    result = []
    for split, values in in_order(metrics.get("splits") or {}).items():
        rows = values.get("per_view") or []
        columns = [(key, title, decimals) for key, title, _, decimals in HEADLINES if any(is_number(row.get(key)) for row in rows)]
        if rows:
            result.append({"split": split, "columns": columns, "rows": rows, "mean": values})
    return result


def total_of(plan_rows: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Seconds of all stages together, and of those that this run took from the store: `seconds`, `cached`."""
    taken = [row for row in plan_rows if row.get("state") != "skipped" and is_number(row.get("seconds"))]
    cached = [float(row["seconds"]) for row in taken if row.get("state") == "cached"]
    return {"seconds": sum(float(row["seconds"]) for row in taken), "cached": sum(cached)}


def worst_first(views: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Views sorted by split, test first, then val, and within a split from worst to best PSNR."""
    order = list(in_order(dict.fromkeys(view["split"] for view in views)))
    return sorted(views, key=lambda view: (order.index(view["split"]), view["psnr"]))


def settings_of(flat: Mapping[str, Mapping[str, Any]], evaluate: Artifact) -> dict[str, Mapping[str, Any]]:
    """Settings by stage, as far as ``flat`` has them; those of `evaluate` come from its provenance."""
    found = {name: info["settings"] for name, info in flat.items() if isinstance(info.get("settings"), Mapping)}
    own = _provenance(evaluate).get("settings")
    return {**found, "evaluate": own} if isinstance(own, Mapping) else found


def _provenance(evaluate: Artifact) -> dict[str, Any]:
    return dict(getattr(evaluate, "provenance", None) or {})


def _strip(strip: Mapping[str, Any], pictures: Mapping[str, str]) -> dict[str, Any]:
    items = [
        {"time": time, "render": pictures.get(f"strip/{k}/render"), "truth": pictures.get(f"strip/{k}/truth")}
        for k, time in enumerate(strip.get("times") or [])
    ]
    return {"camera": strip.get("camera", ""), "items": [item for item in items if item["render"]]}


def _flow(flow: Mapping[str, Any], pictures: Mapping[str, str]) -> dict[str, Any]:
    """For each pair of frames, the available pictures as (title, source). Pairs without rendered flow are left out, since there is nothing
    to compare."""
    items = []
    for pair in flow.get("pairs") or []:
        shown = [(title, pictures[f"{pair['stem']}/{kind}"]) for kind, title in FLOW_KINDS if f"{pair['stem']}/{kind}" in pictures]
        if f"{pair['stem']}/rendered" in pictures:
            items.append({**pair, "shown": shown})
    return {**flow, "wheel": pictures.get("flow/wheel"), "items": items}


def _movies(evaluate: Artifact) -> list[tuple[str, str]]:
    """(title, source) of each available movie."""
    found = read_movies(evaluate)
    return [(title, MOVIE + base64.b64encode(found[name]).decode()) for name, title in MOVIES if name in found]
