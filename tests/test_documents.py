"""What the documents promise exists: settings with their defaults, commands, links, fixtures."""

import json
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from e4dgs.pipeline import settings_by_name
from e4dgs.workflows.cli import ONE_STAGE, app
from e4dgs.workflows.presets import PRESETS
from e4dgs.workflows.publish import PLAYER
from e4dgs.workflows.reconstruction import reconstruction
from run_stage import run_frames, run_stage
from script_module import load_script

NAMES = settings_by_name(reconstruction().settings)
ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text()
DOCUMENTS = [
    "README.md",
    "CONTRIBUTING.md",
    "CHANGELOG.md",
    "DESIGN.md",
    *sorted(f"docs/{page.name}" for page in (ROOT / "docs").glob("*.md")),
]


def test_the_page_of_settings_is_what_the_code_has():
    done = subprocess.run([sys.executable, ROOT / "docs" / "write_settings.py", "--check"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_the_figures_of_the_maths_are_what_the_code_draws():
    done = subprocess.run([sys.executable, ROOT / "docs" / "figures.py", "--check"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_a_figure_that_is_slightly_off_is_stale():
    figures = load_script(ROOT / "docs" / "figures.py")
    for path in figures.FOLDER.iterdir():
        kept = figures.pixels(path)
        assert figures.same(kept, kept) and not figures.same(kept, None)
        assert not figures.same(kept, np.roll(kept, 2, axis=1)), path


def test_settings_that_documents_name_exist():
    groups = "|".join(dict.fromkeys(name.partition(".")[0] for name in NAMES))
    for document in DOCUMENTS:
        for name in re.findall(rf"(?:--set |`)((?:{groups})\.[a-z0-9_]+)[=`]", (ROOT / document).read_text()):
            older = document in ("CHANGELOG.md", "docs/settings.md")  # these have tables of names that are no more
            assert name in NAMES or older, f"{document} names {name}"


def test_older_names_of_settings_lead_to_settings():
    stages = reconstruction().stages.values()
    assert {new for stage in stages for cls in stage.settings.__mro__ for new in vars(cls).get("renamed", {}).values()} <= set(NAMES)


def test_the_command_line_names_all_stages():
    assert ONE_STAGE.endswith(f": {', '.join(reconstruction().stages)}.")


def test_the_readme_is_short():
    assert len(README.splitlines()) <= 120


def test_the_documentation_builds_without_a_warning(tmp_path):
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", str(ROOT / "docs"), str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_the_stage_of_the_documentation_runs(dnerf_capture, tmp_path, monkeypatch):
    page = (ROOT / "docs" / "extending.md").read_text()
    blocks = re.findall(r"`(stages/[\w/]+)\.py`[^\n]*:\n\n```python\n(.*?)```", page, re.DOTALL)
    names = [".".join(["e4dgs", *path.split("/")]) for path, _ in blocks]
    assert names == [f"e4dgs.stages.count.{part}" for part in ("artifact", "run", "settings", "stage")]
    room = ModuleType("e4dgs.stages.count")
    room.__path__ = []  # a package
    monkeypatch.setitem(sys.modules, room.__name__, room)
    for name, (_, source) in zip(names, blocks):
        module = ModuleType(name)
        module.__package__ = name.rpartition(".")[0]
        monkeypatch.setitem(sys.modules, name, module)
        exec(source, module.__dict__)
    stored, _, settings, stage = (sys.modules[name] for name in names)
    frames = run_frames(dnerf_capture.root, tmp_path)
    ran = run_stage(stage.Count(), frames.context.capture, tmp_path, settings.CountSettings(times=2), {"frames": frames.artifact})
    assert stored.StoredCount.read(ran.artifact).count == 2 * frames.context.capture.facts["splits"]["train"]


def test_commands_of_the_readme_exist():
    commands = {command.name or command.callback.__name__ for command in app.registered_commands} | {g.name for g in app.registered_groups}
    code = re.findall(r"```bash\n(.*?)```|`([^`\n]+)`", README, re.DOTALL)
    names = {word for block in code for word in re.findall(r"^e4dgs (\w+)", "".join(block), re.MULTILINE)}
    assert names and names <= commands
    assert set(re.findall(r"--preset (\w+)", README)) <= set(PRESETS)


@pytest.mark.parametrize("document", DOCUMENTS)
def test_links_lead_somewhere(document):
    text = (ROOT / document).read_text()
    for target in re.findall(r"\]\(([^)#]+)\)", text):
        if not target.startswith(("http", "e4dgs-workspace/")):
            assert ((ROOT / document).parent / target).exists(), f"{document} links to {target}"


def test_the_picture_leads_to_the_page_that_the_first_command_writes():
    (target,) = re.findall(r"\]\((e4dgs-workspace/[^)]+)\)", README)
    sample = re.search(r'SAMPLE = "samples/(\w+)"', (ROOT / "dev.py").read_text())[1]
    assert 'ROOT / "e4dgs-workspace"' in (ROOT / "dev.py").read_text() and target == f"e4dgs-workspace/scenes/{sample}/{PLAYER}"


def test_design_pages_are_short():
    for page in [ROOT / "DESIGN.md", *ROOT.glob("[a-z]*/**/DESIGN.md")]:
        words = len(page.read_text().split())
        assert words <= 900, f"{page} has {words} words; figures of trials belong in benchmarks/results/trials.md"


def tracked_pages() -> list[Path]:
    """Every Markdown file of the repository outside benchmarks/, which is for figures."""
    listed = subprocess.run(["git", "ls-files", "-z", "*.md"], cwd=ROOT, capture_output=True, text=True, check=True).stdout.split("\0")
    return [ROOT / name for name in listed if name and not name.startswith("benchmarks/")]


def sentences(text: str) -> list[str]:
    """The sentences of a page in Markdown, cells of tables among them; without code blocks, formulas, links' targets and headings.

    A cell counts as a sentence only where it ends as one, since names and numbers in cells would make any mean look short.
    """
    text = re.sub(r"```.*?```|\$\$.*?\$\$|<!--.*?-->|^    .*?$", "\n\n", text, flags=re.DOTALL | re.MULTILINE)
    text = re.sub(r"^#.*$|^\|[-| ]+\|$", "\n", text, flags=re.MULTILINE)
    text = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", text)
    text = re.sub(r"`[^`]*`|\$[^$]*\$", "Name", text)
    parts = re.split(r"\n\s*\n|\n(?=\s*(?:[-*]|\d+\.) )|\n(?=\|)|\|", text)
    whole = [" ".join(part.split()).strip("*-| ") for part in parts]
    found = [sentence for part in whole for sentence in re.split(r"(?<=[.!?])\**\s+(?=[\"'*(]*[A-Z0-9])", part)]
    return [sentence for sentence in found if re.search(r"[.!?:]\W*$", sentence) and len(sentence.split()) > 1]


def test_sentences_are_counted_as_a_reader_would():
    page = "# A title\n\nOne two three. Four `e4dgs run. all` five [six](seven.md)!\n\n| a | b |\n|---|---|\n| Is it? No. | name |\n\n"
    page += "- An item,\n  two lines.\n- **Bold.** More, e.g. this:\n\n```bash\nnot this.\n```\nNo end"
    expected = ["One two three.", "Four Name five six!", "Is it?", "An item, two lines.", "More, e.g. this:"]
    assert sentences(page) == expected


def test_pages_are_few_bytes_and_short_sentences():
    pages = tracked_pages()
    size = sum(page.stat().st_size for page in pages)
    assert size <= 150_000, f"Markdown outside benchmarks/ has {size:,} bytes"
    lengths = [len(sentence.split()) for page in pages for sentence in sentences(page.read_text())]
    assert len(lengths) > 500 and sum(lengths) / len(lengths) < 20, (
        f"{len(lengths)} sentences, mean {sum(lengths) / len(lengths):.1f} words"
    )


def test_fixtures_named_in_contributing_exist():
    named = set(re.findall(r"`(\w+_capture)`", (ROOT / "CONTRIBUTING.md").read_text()))
    defined = set(re.findall(r"def (\w+_capture)\(", (ROOT / "tests" / "conftest.py").read_text()))
    assert named == defined


def test_rows_and_options_of_the_benchmarks_page_exist():
    from e4dgs.workflows.bench.suites import SUITES

    page = (ROOT / "docs" / "benchmarks.md").read_text()
    calls = re.findall(r"^e4dgs bench (\w+)(.*?)(?:#.*)?$", page, re.MULTILINE)
    assert {suite for suite, _ in calls} == {*SUITES, "pipeline"}
    for suite, options in calls:
        for names in re.findall(r"--rows ([\w,]+)", options):
            assert set(names.split(",")) <= {row.name for row in SUITES[suite]}


def test_the_tables_of_measured_figures_are_those_of_the_results():
    """README, docs and benchmarks.md: between marks, so that no figure is typed and none can differ from page to page."""
    done = subprocess.run([sys.executable, ROOT / "benchmarks" / "publish.py", "--check"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


# Figures with the unit of a measurement. Sizes in px, counts and degrees say what is done, not what was found.
FIGURE = re.compile(r"(?<![\w.])(\d[\d,]*(?:\.\d+)?) ?(dB|min\b|minutes|s\b|ms\b|fps|MB|GB|kB)")
# What no result holds, since nothing was measured: defaults, limits, examples, and bars that tests hold.
STATED = {
    "docs/batches.md": {"4 GB"},
    "docs/hardware.md": {"14 s"},
    "docs/player.md": {"45 ms", "45 dB", "38 dB", "8 MB"},
    "docs/settings.md": {"8 MB"},
    "docs/results.md": {"4 s"},
    "docs/filming.md": {"200 s"},
}


@pytest.mark.parametrize("document", [page for page in DOCUMENTS if page.startswith("docs/") or page == "README.md"])
def test_figures_are_measured_and_traceable(document):
    """A figure outside marked tables and code stands, to the same digits, in the results that its paragraph or row links to."""
    text = re.sub(r"<!-- (\w+) -->\n.*?<!-- end -->|```.*?```|\$\$.*?\$\$", "", (ROOT / document).read_text(), flags=re.DOTALL)
    for part in re.split(r"\n\s*\n|\n(?=\|)", text):
        figures = {" ".join(match.groups()) for match in FIGURE.finditer(re.sub(r"`[^`]*`|\]\([^)]*\)", "", part))}
        links = re.findall(r"\]\(([^)#]*benchmarks/results/[^)#]+)", part)
        results = "".join(((ROOT / document).parent / link).read_text() for link in links)
        missing = figures - STATED.get(document, set()) - {found for found in figures if found in results}
        assert not missing, f"{document}: {missing} in no result that is linked beside: {part[:100]}"


def test_what_others_publish_stands_with_its_protocol_and_source():
    page = (ROOT / "docs" / "comparing.md").read_text().partition("## What others publish")[2]
    rows = [line.strip("|").split("|") for line in page.splitlines() if line.startswith("|")][2:]
    assert rows and all(len(row) == 4 and re.search(r"\d", row[1]) and row[3].strip() for row in rows)
    assert not re.search(r"\d\d\.\d", page.partition("\n| data")[0]), "ours stand on their own page"


def test_a_row_is_of_one_machine_and_the_same_code():
    folder = ROOT / "benchmarks" / "results" / "rows"
    quality_rows = load_script(ROOT / "benchmarks" / "quality_rows.py")
    for path in folder.glob("*.json"):
        row = json.loads(path.read_text())
        assert path.stem in quality_rows.ROWS, f"{path.name} is of no row"
        assert len({(str(run["code"] or run["commit"]), run["machine"]["processor"]) for run in row["runs"]}) == 1, path.name
        assert len({run["seed"] for run in row["runs"]}) == len(row["runs"]), path.name
