"""The report of a scene: one HTML file with its pictures, curves and tables inside, that opens anywhere and needs no network.

Imports neither torch nor a plotting library, so that a cached run can draw it.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..pipeline import Artifact, duration
from .report_plot import Plot, Series, numbers, svg

TEMPLATE = Path(__file__).with_name("report.html.jinja")
TRAINED = ("coarse", "fine")
FLOW_KINDS = (
    ("frame", "ground truth"),
    ("measured", "measured flow"),
    ("rendered", "rendered flow"),
    ("edges", "edges"),
    ("moving", "what moves"),
)
SPLITS = ("test", "val", "train")
MEASURED_AS = ("metrics", "colours", "moving", "flicker")  # of the protocol: sentences, for small print
VIEWS_OPEN = 6  # the others are folded away
DATA, MOVIE = "data:image/png;base64,", "data:video/mp4;base64,"
MOVIES = (("over_time", "held-out views in order of time: ground truth, render"), ("turntable", "a turn about the scene"))
HEADLINES = (  # key, title, unit, decimals
    ("psnr", "PSNR", "dB", 2),
    ("edge_psnr", "PSNR near edges", "dB", 2),
    ("ssim", "SSIM", "", 4),
    ("lpips", "LPIPS", "", 4),
    ("psnr_affine", "PSNR after colour fit", "dB", 2),
    ("ssim_affine", "SSIM after colour fit", "", 4),
    ("psnr_moving", "PSNR of what moves", "dB", 2),
    ("psnr_static", "PSNR of what stands still", "dB", 2),
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
) -> str:
    """The page as HTML text.

    evaluate: its artifact, for the pictures. infos: by stage, attrs and info in one dict (or under "attrs" and "info"), `training` of
    `coarse` and `fine` among them. plan_rows: `stage`, `state`, `reason`, `seconds`, `peak_rss_mb`. metrics: the content of metrics.json.
    seeds: a PNG of where training began. command: what makes the same again. A key that is missing leaves its part of the page out. All
    text is escaped.
    """
    from jinja2 import Environment
    from markupsafe import Markup

    flat = {name: flatten(info) for name, info in infos.items()}
    training = {name: flat[name].get("training") or {} for name in TRAINED if name in flat}
    pictures = {name: DATA + base64.b64encode(data).decode() for name, data in _pictures(evaluate).items()}
    environment = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
    environment.filters |= {"number": number, "duration": lambda s: duration(float(s)) if is_number(s) else "–"}
    attrs, protocol = evaluate.attrs, metrics.get("protocol") or {}
    return environment.from_string(TEMPLATE.read_text(encoding="utf-8")).render(
        scene=scene_name,
        protocol={key: value for key, value in protocol.items() if key not in ("notes", *MEASURED_AS)},
        measured_as=[protocol[key] for key in MEASURED_AS if protocol.get(key)],
        notes=protocol.get("notes") or [],
        headlines=headlines(metrics),
        facts=facts(metrics),
        views=[v for v in worst_first(attrs.get("views", [])) if f"{v['stem']}/render" in pictures],
        views_open=VIEWS_OPEN,
        command=command,
        over_time=[(plot.title, Markup(drawn)) for plot in plots_over_time(metrics) if (drawn := svg(plot))],
        strip=_strip(attrs.get("strip") or {}, pictures),
        flow=_flow(attrs.get("flow") or {}, pictures),
        pictures=pictures,
        movies=_movies(evaluate),
        seeds=None if seeds is None else DATA + base64.b64encode(seeds).decode(),
        plots=[(plot.title, plot.series, Markup(drawn)) for plot in plots(training) if (drawn := svg(plot))],
        splits=tables(metrics),
        training={name: {k: v for k, v in log.items() if not isinstance(v, list)} for name, log in training.items() if log},
        plan=plan_rows,
        slowest=max([float(row["seconds"]) for row in plan_rows if is_number(row.get("seconds"))], default=0.0),
        logs={name: list(info.get("log") or []) for name, info in flat.items() if info.get("log")},
        settings=settings_of(flat, evaluate),
        provenance=_provenance(evaluate),
    )


def flatten(info: Mapping[str, Any]) -> dict[str, Any]:
    """A stage's attrs and info in one dict, whichever way they came."""
    nested = {key: info[key] for key in ("attrs", "info") if isinstance(info.get(key), Mapping)}
    return {**{k: v for k, v in info.items() if k not in nested}, **nested.get("attrs", {}), **nested.get("info", {})}


def is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def number(value: Any, decimals: int = 2) -> str:
    """A number for people, an en dash where there is none."""
    if not is_number(value):
        return "–"
    return f"{value:,}" if isinstance(value, int) else f"{value:.{decimals}f}"


def headlines(metrics: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Per split, test first: its metrics as (title, text, unit, hint)."""
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
    """Training time, speed and size."""
    primitives = metrics.get("primitives") or {}
    found = []
    if is_number(metrics.get("train_seconds")):
        found.append(("trained in", duration(float(metrics["train_seconds"]))))
    flicker = metrics.get("flicker") or {}
    for name, title, unit in (("static", "flicker where nothing moves", "levels"), ("edges", "flicker at edges", "levels")):
        if is_number(flicker.get(name)):
            found.append((title, f"{flicker[name]:.2f} {unit}"))
    if is_number(metrics.get("render_fps")):
        found.append(("renders at", f"{metrics['render_fps']:.3g} frames/s"))
    found += [(kind, number(primitives[kind])) for kind in ("gaussians", "convexes") if kind in primitives]
    return found


def tables(metrics: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Per split the columns that hold anything, and a row a view."""
    result = []
    for split, values in in_order(metrics.get("splits") or {}).items():
        rows = values.get("per_view") or []
        columns = [(key, title, decimals) for key, title, _, decimals in HEADLINES if any(is_number(row.get(key)) for row in rows)]
        if rows:
            result.append({"split": split, "columns": columns, "rows": rows, "mean": values})
    return result


def plots(training: Mapping[str, Mapping[str, Any]]) -> list[Plot]:
    """Loss, PSNR and primitives over the steps of all stages, one after the other."""
    starts, total = {}, 0.0
    for name, log in training.items():
        starts[name] = total
        steps = [x for key in ("loss", "psnr", "primitives") for x, _ in numbers(log.get(key), 1)]
        given = log.get("iterations")
        total += max([float(given) if is_number(given) else 0.0, *steps])  # type: ignore[arg-type]
    marks = [(start, name) for name, start in starts.items() if start > 0]

    def curve(key: str, column: int) -> list[tuple[float, float]]:
        return [(x + starts[name], y) for name, log in training.items() for x, y in numbers(log.get(key), column)]

    kinds = [Series("Gaussians", curve("primitives", 1), "a"), Series("convexes", curve("primitives", 2), "b")]
    return [
        Plot("Loss", "step", "loss", [Series("loss", curve("loss", 1))], marks, log=True),
        Plot("PSNR of training views", "step", "dB", [Series("PSNR", curve("psnr", 1))], marks),
        Plot("Primitives", "step", "count", kinds, marks),
    ]


def plots_over_time(metrics: Mapping[str, Any]) -> list[Plot]:
    """PSNR of each measured view over its time, for splits with several times."""
    found = []
    for split, values in in_order(metrics.get("splits") or {}).items():
        points = sorted(numbers([[row.get("time"), row.get("psnr")] for row in values.get("per_view") or []], 1))
        if len({time for time, _ in points}) > 1:
            found.append(Plot(f"PSNR over time, {split}", "time", "dB", [Series(split, points)]))
    return found


def worst_first(views: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Views of test come first, then those of val; the worst of each come first."""
    order = list(in_order(dict.fromkeys(view["split"] for view in views)))
    return sorted(views, key=lambda view: (order.index(view["split"]), view["psnr"]))


def in_order(splits: Mapping[str, Any]) -> dict[str, Any]:
    """``splits`` with test first, then val, then train."""
    return {name: splits[name] for name in sorted(splits, key=lambda name: SPLITS.index(name) if name in SPLITS else len(SPLITS))}


def settings_of(flat: Mapping[str, Mapping[str, Any]], evaluate: Artifact) -> dict[str, Mapping[str, Any]]:
    """Settings by stage, as far as they were handed in; those of `evaluate` come from its provenance."""
    found = {name: info["settings"] for name, info in flat.items() if isinstance(info.get("settings"), Mapping)}
    own = _provenance(evaluate).get("settings")
    return {**found, "evaluate": own} if isinstance(own, Mapping) else found


def _provenance(evaluate: Artifact) -> dict[str, Any]:
    return dict(getattr(evaluate, "provenance", None) or {})


def _pictures(evaluate: Artifact) -> dict[str, bytes]:
    from .evaluation_pictures import read_pictures

    return read_pictures(evaluate)


def _strip(strip: Mapping[str, Any], pictures: Mapping[str, str]) -> dict[str, Any]:
    items = [
        {"time": time, "render": pictures.get(f"strip/{k}/render"), "truth": pictures.get(f"strip/{k}/truth")}
        for k, time in enumerate(strip.get("times") or [])
    ]
    return {"camera": strip.get("camera", ""), "items": [item for item in items if item["render"]]}


def _flow(flow: Mapping[str, Any], pictures: Mapping[str, str]) -> dict[str, Any]:
    """Per pair of frames the pictures that there are, as (title, source); without a rendered flow there is nothing to compare."""
    items = []
    for pair in flow.get("pairs") or []:
        shown = [(title, pictures[f"{pair['stem']}/{kind}"]) for kind, title in FLOW_KINDS if f"{pair['stem']}/{kind}" in pictures]
        if f"{pair['stem']}/rendered" in pictures:
            items.append({**pair, "shown": shown})
    return {**flow, "wheel": pictures.get("flow/wheel"), "items": items}


def _movies(evaluate: Artifact) -> list[tuple[str, str]]:
    """(title, source) of each movie that there is."""
    from .evaluation_movies import read_movies

    found = read_movies(evaluate)
    return [(title, MOVIE + base64.b64encode(found[name]).decode()) for name, title in MOVIES if name in found]
