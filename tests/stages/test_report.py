"""The report: self-contained, complete, escaped, tolerant of what is missing, and drawn without torch."""

import base64
import html.parser
import re
import subprocess
import sys
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from e4dgs.stages.report.curves import training_curves
from e4dgs.stages.report.page import headlines, render_report
from e4dgs.stages.report.plot import MOST_POINTS, Plot, Series, numbers, svg

EVIL = "<script>alert(1)</script>\"'&"


class Evaluation:
    """Stands for an `evaluate` artifact: two views and a strip, pictures that are any bytes."""

    def __init__(self, name: str = "r_000") -> None:
        names = [f"test/{i}/{kind}" for i in (3, 7) for kind in ("truth", "render", "error", "edges", "depth")]
        names += ["strip/0/render", "strip/0/truth", "strip/1/render", "strip/1/truth"]
        blobs = [f"picture {k}".encode() for k in range(len(names))]
        self.arrays = {"png": np.frombuffer(b"".join(blobs), np.uint8), "png_offsets": np.cumsum([0, *map(len, blobs)])}
        self.attrs = {
            "png_names": names,
            "views": [{"stem": f"test/{i}", "split": "test", "name": name, "time": 0.5, "psnr": 31.25, "ssim": 0.95} for i in (3, 7)],
            "strip": {"camera": name, "times": [0.0, 1.0]},
        }
        self.provenance = {"settings": {"max_views": 8}, "libraries": {"numpy": "2"}, "seconds": 3.5, "log": ["a line"]}

    def __contains__(self, name: str) -> bool:
        return name in self.arrays

    def read(self, name: str) -> np.ndarray:
        return self.arrays[name]


class WithFlow(Evaluation):
    """Two pairs of frames; only the second one's camera has a mask of what moves."""

    def __init__(self, name: str = "r_000") -> None:
        super().__init__(name)
        kinds = [(0, "frame"), (0, "measured"), (0, "rendered"), (0, "edges")]
        kinds += [(1, "frame"), (1, "measured"), (1, "rendered"), (1, "edges"), (1, "moving")]
        names = [f"flow/{k}/{kind}" for k, kind in kinds] + ["flow/wheel"]
        blobs = [name.encode() for name in names]
        self.arrays["png"] = np.concatenate([self.arrays["png"], np.frombuffer(b"".join(blobs), np.uint8)])
        ends = self.arrays["png_offsets"][-1] + np.cumsum([len(blob) for blob in blobs])
        self.arrays["png_offsets"] = np.concatenate([self.arrays["png_offsets"], ends])
        self.attrs["png_names"] += names
        pair = {"frames": [name, "r_001"], "times": [0.25, 0.5], "difference": 0.375, "motion": 2.5, "at_edges": 0.25}
        rows = [{**pair, "stem": "flow/0"}, {**pair, "stem": "flow/1", "difference": None, "motion": None, "at_edges": None}]
        self.attrs["flow"] = {"largest": 7.25, "method": name, "pairs": rows}


def metrics(name: str = "r_000") -> dict:
    row = {"name": name, "frame": 3, "time": 0.5, "psnr": 31.25, "ssim": 0.95, "edge_psnr": None, "lpips": None}
    test = {"psnr": 31.25, "ssim": 0.95, "edge_psnr": 27.5, "lpips": None, "lpips_reason": "no weights given", "per_view": [row]}
    return {
        "scene": "robot",
        "protocol": {
            "resolution": "400x400",
            "split": "test (20 views)",
            "background": "white",
            "lpips_net": None,
            "notes": ["held out 8"],
        },
        "splits": {"val": {**test, "psnr": 33.0}, "test": test},
        "primitives": {"gaussians": 12345, "convexes": 678},
        "train_seconds": 754.0,
        "render_fps": 12.25,
    }


def infos() -> dict:
    log = {"loss": [[0, 0.4], [50, 0.1], [100, 0.05]], "psnr": [[0, 10.0], [100, 25.0]], "primitives": [[0, 100, 0], [100, 200, 30]]}
    extra = {"iterations": 100, "seconds": 61.0, "skipped": {"flow terms": 12}, "nonfinite_steps": 0, "stopped": "converged"}
    return {"coarse": {"training": {**log, **extra}, "log": ["seeds: 100"]}, "fine": {"training": {**log, **extra, "iterations": 100}}}


PLAN = [
    {"stage": "poses", "state": "skipped", "reason": "the files hold poses", "seconds": 0.0, "peak_rss_mb": 0.0},
    {"stage": "coarse", "state": "cached", "reason": "nothing changed", "seconds": 61.0, "peak_rss_mb": 512.4},
]


@pytest.fixture(scope="module")
def page() -> str:
    return render_report("robot", Evaluation(), infos(), PLAN, metrics())  # type: ignore[arg-type]


class Balanced(html.parser.HTMLParser):
    """Fails where a closing tag does not match; collects visible text and references."""

    VOID = frozenset({"meta", "img", "br", "link", "input"})

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.text: list[str] = []
        self.references: list[str] = []
        self.scripts = 0

    def handle_starttag(self, tag, attrs):
        self.scripts += tag == "script"
        self.references += [value for key, value in attrs if key in ("src", "href") and value]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.references += [value for key, value in attrs if key in ("src", "href") and value]

    def handle_endtag(self, tag):
        assert self.open and self.open.pop() == tag, f"unexpected </{tag}>"

    def handle_data(self, data):
        self.text.append(data)


def parse(page: str) -> Balanced:
    parser = Balanced()
    parser.feed(page)
    parser.close()
    assert not parser.open
    return parser


def test_the_page_holds_everything_and_refers_to_nothing_outside(page):
    parser = parse(page)
    assert parser.references and all(reference.startswith("data:image/png;base64,") for reference in parser.references)
    assert not re.search(r"https?://", page)
    text = re.sub(r"\s+", " ", " ".join(parser.text))
    for expected in (
        "robot",
        "400x400",
        "white",
        "31.25",
        "27.50",
        "0.9500",
        "no weights given",
        "12 min 34 s",
        "12.2 frames/s",
        "12,345",
        "678",
        "held out 8",
        "ground truth",
        "error × 4",
        "only in the ground truth",
        "the files hold poses",
        "512 MB",
        "converged",
        "flow terms",
        "seeds: 100",
        "evaluate.max_views",
    ):
        assert expected in text, expected


def test_test_split_comes_first():
    assert [group["split"] for group in headlines(metrics())] == ["test", "val"]


def test_every_text_is_escaped():
    plan = [{**row, "reason": EVIL, "stage": EVIL} for row in PLAN]
    values = metrics(EVIL)
    values["protocol"] = {"resolution": EVIL, "notes": [EVIL]}
    values["splits"]["test"]["lpips_reason"] = EVIL
    stages = {"coarse": {"training": {"stopped": EVIL, "skipped": {EVIL: 1}}, "log": [EVIL], "settings": {EVIL: EVIL}}}
    page = render_report(EVIL, WithFlow(EVIL), stages, plan, values)  # type: ignore[arg-type]
    parser = parse(page)
    assert parser.scripts == 1 and "<script>alert" not in page
    assert page.count("&lt;script&gt;alert(1)&lt;/script&gt;") > 10


def test_where_training_began_is_shown_when_known():
    args = "robot", Evaluation(), infos(), PLAN, metrics()
    assert "where training began" in render_report(*args, b"png") and "cG5n" in render_report(*args, b"png")  # type: ignore[arg-type]
    assert "where training began" not in render_report(*args)  # type: ignore[arg-type]


def test_the_command_and_the_quality_over_time_are_shown_when_known():
    values = metrics()
    values["splits"]["test"]["per_view"] = [{"time": t, "psnr": 30 + t} for t in (0.0, 0.5, 1.0)]
    shown = render_report("robot", Evaluation(), infos(), PLAN, values, None, "e4dgs run all 'my capture'")  # type: ignore[arg-type]
    assert "e4dgs run all &#39;my capture&#39;" in shown and "PSNR over time, test" in shown and "PSNR over time, val" not in shown
    without = render_report("robot", Evaluation(), infos(), PLAN, metrics())  # type: ignore[arg-type]
    assert "Flicker is measured if" not in shown
    assert "Flicker is measured if" in render_report("robot", Evaluation(), infos(), PLAN, {**values, "flicker": None})  # type: ignore[arg-type]
    assert "The same again" not in without and "PSNR over time" not in without, "one time is no course"


def test_movies_play_in_the_page():
    class WithMovie(Evaluation):
        def __contains__(self, name):
            return name == "movie_turntable" or super().__contains__(name)

        def read(self, name):
            return np.frombuffer(b"mp4", np.uint8) if name == "movie_turntable" else super().read(name)

    shown = render_report("robot", WithMovie(), infos(), PLAN, metrics())  # type: ignore[arg-type]
    assert parse(shown).references.count("data:video/mp4;base64,bXA0") == 1 and "<video" in shown
    assert "<video" not in render_report("robot", Evaluation(), infos(), PLAN, metrics())  # type: ignore[arg-type]


def test_six_views_are_open_and_the_others_are_folded():
    class Many(Evaluation):
        def __init__(self):
            super().__init__()
            view = self.attrs["views"][0]
            self.attrs = {**self.attrs, "views": [{**view, "name": f"view {k}", "psnr": 30.0 - k} for k in range(8)]}

    shown = render_report("robot", Many(), infos(), PLAN, metrics())  # type: ignore[arg-type]
    parse(shown)
    assert "2 more views" in shown and shown.index("view 7") < shown.index("view 2") < shown.index("2 more views") < shown.index("view 1")


def test_pairs_of_frames_stand_beside_their_flow():
    page = render_report("robot", WithFlow(), {}, [], {})  # type: ignore[arg-type]
    parser = parse(page)
    text = " ".join(parser.text)
    for expected in (
        "full colour is 7.2 px",
        "r_000 → r_001",
        "t = 0.250 → 0.500",
        "differ by 0.38 px",
        "(0.25 px at edges, the median)",
        "motion 2.50 px",
        "differ by – px",
    ):
        assert expected in text, expected
    titles = ["ground truth", "measured flow", "rendered flow", "edges"]
    section = page[page.index("<h2>Flow") : page.index("<script>")]
    assert re.findall(r"<span>(.*?)</span>", section) == [*titles, *titles, "moving pixels"]
    shown = [base64.b64decode(url.split(",")[1]).decode() for url in re.findall(r'src="(.*?)"', section)]
    assert shown == ["flow/wheel", *WithFlow().attrs["png_names"][-10:-1]]
    assert "repeat(4," in section and "repeat(5," in section
    without = render_report("robot", Evaluation(), {}, [], {})  # type: ignore[arg-type]
    assert "<h2>Flow" not in without and "rendered flow" not in without


def test_missing_parts_are_left_out():
    bare = Evaluation()
    bare.arrays, bare.attrs, bare.provenance = {}, {}, {}
    page = render_report("empty", bare, {}, [], {})  # type: ignore[arg-type]
    parse(page)
    for heading in ("Views", "Over time", "Flow", "Training", "Per view", "Plan"):
        assert f"<h2>{heading}" not in page
    odd = {"coarse": {"training": {"loss": None, "psnr": [[0, None], [1, float("nan")], "x"]}}, "fine": {}}
    rows = [{"stage": "coarse", "state": "ran"}]
    bare.attrs = {"flow": {"largest": 1.0, "pairs": [{"stem": "flow/0"}]}}  # its pictures are not there
    parse(render_report("odd", bare, odd, rows, {"splits": {"test": {"psnr": None, "per_view": [{}]}}}))  # type: ignore[arg-type]


def test_infos_may_be_nested():
    flat, nested = infos(), {name: {"attrs": {}, "info": info} for name, info in infos().items()}
    pages = [render_report("robot", Evaluation(), given, PLAN, metrics()) for given in (flat, nested)]  # type: ignore[arg-type]
    assert pages[0] == pages[1]


def test_curves_of_fine_follow_those_of_coarse():
    loss, psnr, primitives = training_curves({name: info["training"] for name, info in infos().items()})
    assert [x for x, _ in loss.series[0].points] == [0, 50, 100, 100, 150, 200]
    assert loss.marks == [(100.0, "fine")] and loss.log and not psnr.log
    assert [s.label for s in primitives.series] == ["Gaussians", "convexes"]


@pytest.mark.parametrize("log", [False, True])
@pytest.mark.parametrize(
    "points",
    [
        [(0.0, 1.0), (1.0, 1.0)],
        [(0.0, 1e-6), (5.0, 3e4)],
        [(3.0, 2.0), (3.0, 2.1)],
        [(float(k), 1.0 + k) for k in range(5000)],
        [(0.0, 0.2), (10.0, 0.5)],
    ],
)
def test_plots_are_valid_and_stay_inside_their_frame(points, log):
    drawn = svg(Plot("a < b", "step", "y & z", [Series("s<", points)], [(1.0, "<fine>")], log=log))
    root = ET.fromstring(drawn)
    line = next(element for element in root.iter() if element.tag.endswith("polyline"))
    placed = np.array([[float(v) for v in pair.split(",")] for pair in line.attrib["points"].split()])
    _, _, width, height = map(float, root.attrib["viewBox"].split())
    assert 2 <= len(placed) <= MOST_POINTS
    assert (placed >= 0).all() and (placed[:, 0] <= width).all() and (placed[:, 1] <= height).all()
    assert sum(element.tag.endswith("line") and element.get("class") == "grid" for element in root.iter()) >= 2


@pytest.mark.parametrize(
    ("xs", "labels"),
    [
        ((0, 6000), ["0", "2000", "4000", "6000"]),
        ((0.2, 0.8), ["0.2", "0.4", "0.6", "0.8"]),  # a step of 0.5 would leave one
        ((0.0625, 0.9375), ["0.2", "0.4", "0.6", "0.8"]),
        ((0, 30000), ["0", "10k", "20k", "30k"]),
        ((0, 12_000_000), ["0", "5M", "10M"]),
        ((7, 7.0001), ["7", "7.00005", "7.0001"]),
    ],
)
def test_the_x_axis_has_several_ticks_that_are_not_cut(xs, labels):
    root = ET.fromstring(svg(Plot("t", "step", "dB", [Series("s", [(float(x), 10.0 + k) for k, x in enumerate(xs)])])))
    texts = [element for element in root.iter() if element.tag.endswith("text") and element.get("text-anchor") == "middle"]
    below = [(element.text, float(element.get("x"))) for element in texts if element.text not in ("step", "dB")]
    assert [text for text, _ in below] == labels
    width = float(root.attrib["viewBox"].split()[2])
    for (text, x), (_, following) in zip(below, [*below[1:], ("", np.inf)]):
        assert 3.5 * len(text) <= x <= width - 3.5 * len(text), "a digit is 7 px wide"
        assert following - x > 7 * len(text), "they do not run into one another"


def test_the_ticks_of_narrow_and_of_logarithmic_axes_can_be_told_apart():
    def left(points, log=False):
        root = ET.fromstring(svg(Plot("t", "x", "y", [Series("s", points)], log=log)))
        return [(e.text, float(e.get("x"))) for e in root.iter() if e.tag.endswith("text") and e.get("text-anchor") == "end"]

    narrow = left([(0.0, 30.0001), (1.0, 30.0004)])
    assert [text for text, _ in narrow] == ["30.0001", "30.0002", "30.0003", "30.0004"]
    assert min(x - 7 * len(text) for text, x in narrow) > 16, "the axis' own text is left of them"
    assert [text for text, _ in left([(0.0, 0.001), (1.0, 20000.0)], log=True)][-3:] == ["100", "1000", "10k"]


def test_the_colours_of_depth_have_a_scale():
    class Deep(Evaluation):
        def __init__(self):
            super().__init__()
            self.attrs["views"] = [view | {"depth_range": span} for view, span in zip(self.attrs["views"], ([2.345, 10.5], None))]

    shown = render_report("robot", Deep(), infos(), PLAN, metrics())  # type: ignore[arg-type]
    text = " ".join(parse(shown).text)
    assert shown.count('class="scale"') == 1 and "2.35" in text and "10.5" in text and "units of the capture's world" in text
    assert "units of the capture" not in " ".join(parse(render_report("robot", Evaluation(), infos(), PLAN, metrics())).text)  # type: ignore[arg-type]


def test_plots_without_two_points_are_left_out():
    assert svg(Plot("t", "x", "y", [Series("s", [(0.0, 1.0)])])) == ""
    assert svg(Plot("t", "x", "y", [Series("s", [(0.0, -1.0), (1.0, 0.0)])], log=True)) == ""
    assert numbers([[0, 1], [1, None], ["a", 2], [2, float("inf")], [3]], 1) == [(0.0, 1.0)]


def test_the_report_is_drawn_without_torch_or_a_plotting_library():
    code = (
        "import sys; from e4dgs.stages.report.page import render_report; from types import SimpleNamespace\n"
        "class A(dict):\n    attrs = {}\n"
        "render_report('s', A(), {}, [], {})\n"
        "print([m for m in ('torch', 'matplotlib', 'cv2', 'scipy', 'pycolmap', 'open3d') if m in sys.modules])"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip() == "[]"
