"""README.md says which test holds which reported failure: every test that it names is there to be collected."""

import ast
import re
from collections import Counter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
ROWS = [line for line in (Path(__file__).with_name("README.md")).read_text().splitlines() if line.startswith("| ")][1:]


def collected(path: str) -> set[str]:
    """Names that pytest takes for tests: functions at the top of a test file, each defined once (a second one hides the first)."""
    tree = ast.parse((ROOT / path).read_text())
    names = Counter(node.name for node in tree.body if isinstance(node, ast.FunctionDef) and node.name.startswith("test_"))
    return {name for name, count in names.items() if count == 1}


def test_every_reported_failure_has_a_row() -> None:
    assert len(ROWS) == 22


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.split("|")[1].strip())
def test_the_named_tests_exist(row: str) -> None:
    named = re.findall(r"`([^`]+)::([^`]+)`", row)
    assert named
    for path, name in named:
        assert Path(path).name.startswith("test_") and name in collected(path), f"{path}::{name}"
