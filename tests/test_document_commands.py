"""Every command that README and docs/ print in a block of bash is one: the real parser takes its words."""

import ast
import re

import pytest
import typer
from e4dgs.workflows.cli import app
from printed_commands import PAGES, ROOT, lines_of

COMMANDS = [pytest.param(page, words, id=f"{page}: {' '.join(words)}") for page in PAGES for words in lines_of(page)]


def test_blocks_are_found():
    assert len(COMMANDS) > 40 and {words.values[1][0] for words in COMMANDS} <= {"e4dgs", "python", "python3", "pip", "source", "sudo"}


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
    elif words[0] == "pip":
        assert words[1] == "install" and words[2] != "e4dgs", "it is on no package index"
    else:
        assert words[:3] == ["sudo", "apt", "install"]
        packages = set(words[3:])
        assert f"`{' '.join(words[3:])}`" in (ROOT / "README.md").read_text()
        assert packages <= set(re.findall(r"[\w+-]+", (ROOT / "dev.py").read_text())), "dev.py names what is missing"


def parse(words: list[str]) -> None:
    """The words down to the last command, every option with its type; raises a usage error."""
    command = typer.main.get_command(app)
    context = command.make_context("e4dgs", words, resilient_parsing=False)
    while (rest := [*getattr(context, "_protected_args", []), *context.args]) and hasattr(command, "resolve_command"):
        name, command, rest = command.resolve_command(context, rest)
        context = command.make_context(name, rest, parent=context)


@pytest.mark.parametrize("page", PAGES)
def test_commands_within_sentences_exist(page):
    """They may leave out what a block of bash would have; commands and options are real."""
    for code in re.findall(r"`(e4dgs [^`]+)`", (ROOT / page).read_text()):
        command, words = (top := typer.main.get_command(app)), code.split()[1:]
        while words and words[0] in getattr(command, "commands", ()):
            command = command.commands[words.pop(0)]
        known = {option for parameter in command.params for option in parameter.opts}
        assert command is not top or not words or words[0].startswith("--"), f"{page}: there is no command `{code}`"
        assert {word for word in words if word.startswith("--")} <= known, f"{page}: `{code}`"


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
