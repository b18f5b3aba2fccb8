"""Every command that README and docs/ print in a block of bash is one: the real parser takes its words, and quick ones run."""

import ast
import re
import shlex
from pathlib import Path

import pytest
import typer
from e4dgs.workflows.cli import app, main

ROOT = Path(__file__).resolve().parents[1]
PAGES = ["README.md", *(str(page.relative_to(ROOT)) for page in sorted((ROOT / "docs").glob("*.md")))]


def lines_of(page: str) -> list[list[str]]:
    """The words of every line in the page's blocks of bash, comments left out."""
    blocks = re.findall(r"```bash\n(.*?)```", (ROOT / page).read_text(), re.DOTALL)
    lines = [line for block in blocks for line in block.replace("\\\n", " ").splitlines()]
    return [words for line in lines if (words := shlex.split(line, comments=True))]


COMMANDS = [pytest.param(page, words, id=f"{page}: {' '.join(words)}") for page in PAGES for words in lines_of(page)]


def test_blocks_are_found():
    assert len(COMMANDS) > 40 and {words.values[1][0] for words in COMMANDS} <= {"e4dgs", "python", "python3", "pip", "source"}


@pytest.mark.parametrize(("page", "words"), COMMANDS)
def test_a_printed_command_is_one(page, words):
    if words[0] == "e4dgs":
        parse(words[1:])
    elif words[0].startswith("python"):
        script = ROOT / words[1]
        assert script.is_file()
        options = [word.split("=")[0] for word in words[2:] if word.startswith("--")]
        strings = {node.value for node in ast.walk(ast.parse(script.read_text())) if isinstance(node, ast.Constant)}
        assert set(options) <= strings, f"{script} knows no {options}"
        if script.name == "dev.py":
            assert words[2] in strings
    elif words[0] == "source":
        assert words[1:] == [".venv/bin/activate"]
    else:
        assert words[:2] == ["pip", "install"]


def parse(words: list[str]) -> None:
    """The words down to the last command, every option with its type; raises a usage error."""
    command = typer.main.get_command(app)
    context = command.make_context("e4dgs", words, resilient_parsing=False)
    while (rest := [*getattr(context, "_protected_args", []), *context.args]) and hasattr(command, "resolve_command"):
        name, command, rest = command.resolve_command(context, rest)
        context = command.make_context(name, rest, parent=context)


@pytest.mark.parametrize(
    "words", ["run all", "plan x --presett fast", "render x --out a.mp4 --frames many", "export obj x", "view x --port 0"]
)
def test_the_parser_refuses_what_is_no_command(words):
    with pytest.raises(Exception, match=r"(?i)missing|no such|valid|greater") as caught:
        parse(words.split())
    assert caught.value.exit_code == 2


def test_extras_that_are_named_exist():
    import tomllib

    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    for page in PAGES:
        for names in re.findall(r"e4dgs\[([\w,]+)\]", (ROOT / page).read_text()):
            assert set(names.split(",")) <= extras.keys(), f"{page} names {names}"


# Which of the fixtures stands for a path that README names.
CAPTURES = {
    "CAPTURE": "dnerf_capture",
    "clip.mp4": "video_capture",
    "photos/": "images_capture",
    "data/dnerf/lego": "dnerf_capture",
    "data/n3v/coffee_martini": "n3v_capture",
    "data/panoptic/basketball": "panoptic_capture",
    "data/mine": "nerfstudio_capture",
}
RUNS = [
    words for words in lines_of("README.md") if words[:3] == ["e4dgs", "run", "all"] or words[:2] in (["e4dgs", "plan"], ["e4dgs", "why"])
]


@pytest.mark.parametrize("words", RUNS, ids=" ".join)
def test_a_run_is_planned_as_printed(words, request, tmp_path, capsys):
    """With `run` put as `plan`: settings, presets and formats are real, and fit the capture that they stand beside."""
    place = next(k for k, word in enumerate(words) if word in CAPTURES)
    options = [word for word in words[place + 1 :] if word != "--view"]
    if "--workspace" in options:
        del options[(at := options.index("--workspace")) : at + 2]
    capture = str(request.getfixturevalue(CAPTURES[words[place]]).root)
    command = words[1:3] if words[1] == "why" else ["plan"]
    assert main([*command, capture, "--workspace", str(tmp_path / "work"), "--device", "cpu", *options]) == 0, capsys.readouterr().err
    assert words[1] == "why" or "evaluate" in capsys.readouterr().out
    assert not (tmp_path / "work").exists(), "a plan writes nothing"


@pytest.mark.parametrize("words", [["list"], ["gc"], ["verify"]], ids=" ".join)
def test_commands_about_a_workspace_run_on_an_empty_one(words, tmp_path):
    assert main([*words, "--workspace", str(tmp_path / "work")]) == 0
