"""`e4dgs doctor --licenses`, and the page on licences."""

import tomllib
from email.message import Message
from importlib import metadata
from pathlib import Path

import pytest
from e4dgs.workflows.machine import licences
from packaging.requirements import Requirement

ROOT = Path(__file__).resolve().parents[2]
STATED = {
    "one": ([("License-Expression", "MIT OR Apache-2.0"), ("License", "old")], "MIT OR Apache-2.0"),
    "two": ([("License", "BSD-3-Clause"), ("Classifier", "License :: OSI Approved :: BSD License")], "BSD-3-Clause"),
    "three": ([("License", "Copyright ...\nall of it"), ("Classifier", "License :: OSI Approved :: BSD License")], "BSD License"),
    "four": ([("License-File", "LICENSE.txt")], "see its file LICENSE.txt"),
    "five": ([], "not stated"),
}


@pytest.fixture
def packages(monkeypatch):
    def about(name):
        if name not in STATED:
            raise metadata.PackageNotFoundError(name)
        message = Message()
        for field, value in [("Version", "1.2"), *STATED[name][0]]:
            message[field] = value
        return message

    asked = [*STATED, "six; extra == 'raft'", "seven; extra == 'dev'", "eight; sys_platform == 'nowhere'"]
    monkeypatch.setattr(licences.metadata, "requires", lambda name: asked)
    monkeypatch.setattr(licences.metadata, "metadata", about)


def test_each_package_has_the_licence_that_it_states(packages):
    found = {one.name: one for one in licences.licences()}
    assert {name: found[name].terms for name in STATED} == {name: terms for name, (_, terms) in STATED.items()}
    assert found["two"].version == "1.2" and found["six"] == ("six", "", "not installed", "extra raft")
    assert found["e4dgs"].terms == "Apache-2.0" and not {"seven", "eight"} & found.keys()
    assert found["RAFT weights"].terms == "BSD-3-Clause" and found["samples/cube_and_ball"].terms == "CC0-1.0"


def test_the_command_prints_them_and_checks_nothing(packages, cli, monkeypatch):
    monkeypatch.setattr("e4dgs.workflows.machine.doctor.checks", lambda workspace: 1 / 0)
    result = cli("doctor", "--licenses")
    assert result.code == 0 and len(result.out.splitlines()) == len(licences.licences())
    assert [line.split() for line in result.out.splitlines() if line.startswith("two")] == [["two", "1.2", "BSD-3-Clause"]]


def test_the_page_names_every_package_and_weight():
    page = (ROOT / "docs" / "licences.md").read_text()
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = [lines for extra, lines in project["optional-dependencies"].items() if extra != "dev"]
    for line in [*project["dependencies"], *(line for lines in extras for line in lines)]:
        assert Requirement(line).name in page
    for word in ("flow.weights", "evaluate.lpips_weights", "samples/cube_and_ball", "doctor --licenses"):
        assert word in page


def test_the_sample_says_the_same():
    assert "CC0 1.0" in (ROOT / "samples" / "cube_and_ball" / "README.md").read_text()
