"""A few small damages to a sound capture of every layout, and again all that once broke a rule."""

import json
import shutil
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings

from .captures import LAYOUTS
from .mutations import make, mutations
from .referee import examine

CORPUS = sorted(Path(__file__).with_name("corpus").glob("*.json"))
FEW = settings(max_examples=6, derandomize=True, deadline=None, database=None, suppress_health_check=list(HealthCheck))


@pytest.mark.parametrize("layout", LAYOUTS)
def test_damage_is_refused_in_one_line_or_does_no_harm(layout, tmp_path):
    @FEW
    @given(steps=mutations())
    def attempt(steps):
        sandbox = tmp_path / "sandbox"
        shutil.rmtree(sandbox, ignore_errors=True)
        sandbox.mkdir()
        examine(sandbox, make(layout, steps, sandbox))

    attempt()


@pytest.mark.parametrize("file", CORPUS, ids=lambda file: file.stem)
def test_what_was_found_before(file, tmp_path):
    entry = json.loads(file.read_text())
    examine(tmp_path, make(entry["layout"], entry["steps"], tmp_path))
