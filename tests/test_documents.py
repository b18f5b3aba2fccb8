"""What the documents promise exists: settings with their defaults, commands, links, fixtures."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
from e4dgs.workflows.cli import app
from e4dgs.workflows.presets import PRESETS
from e4dgs.workflows.reconstruction import reconstruction

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text()
DOCUMENTS = ["README.md", "CONTRIBUTING.md", "CHANGELOG.md", "DESIGN.md", "docs/index.md", "docs/benchmarks.md"]


def settings_table() -> list[tuple[list[str], str]]:
    """Rows of README's table of settings: the keys in the first column, the default in the second."""
    section = README.split("## Settings")[1].split("\n## ")[0]
    rows = [line.strip("|").split("|") for line in section.splitlines() if line.startswith("| `")]
    return [(re.findall(r"`([a-z0-9_.]+)`", row[0]), row[1].strip().strip("`")) for row in rows]


def test_settings_of_the_readme_exist_with_these_defaults():
    stages = {stage.name: stage.settings for stage in reconstruction().stages.values()}
    rows = settings_table()
    assert len(rows) > 15
    for keys, default in rows:
        for key in keys:
            stage, field = key.split(".")
            assert field in stages[stage].model_fields, f"README names {key}"
            actual = stages[stage].model_fields[field].default
            shown = ",".join(actual) if isinstance(actual, tuple) else str(actual)
            # a default of None is explained in words, or not at all
            assert actual is None or shown == default, f"README gives {key} the default {default}, the code {shown}"


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
        if not target.startswith("http"):
            assert ((ROOT / document).parent / target).exists(), f"{document} links to {target}"


def test_design_pages_are_short():
    for page in [ROOT / "DESIGN.md", *ROOT.glob("[a-z]*/DESIGN.md")]:
        assert len(page.read_text().splitlines()) <= 120, page


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


def test_tables_of_the_benchmarks_page_are_those_of_the_results():
    done = subprocess.run([sys.executable, ROOT / "benchmarks" / "tables.py", "--check"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
