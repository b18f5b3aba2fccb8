"""Commands end well on terminals, logs and pipes of any encoding and width."""

import json
import os
import subprocess
import sys

import pytest

LETTERS = "px² ü 球 \U0001f642 \udcff"  # the last is a byte of a file name that is no text


def printed(code: str, encoding: str, **more: str) -> str:
    environment = {**os.environ, "PYTHONIOENCODING": encoding, **more}
    code = f"import json, sys; from e4dgs.workflows.machine.terminal import write_any_letter; write_any_letter(); {code}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, env=environment)
    assert done.returncode == 0, done.stderr
    return done.stdout.decode(encoding)


@pytest.mark.parametrize("encoding", ["ascii", "gbk", "latin-1", "cp1252", "utf-8"])
def test_letters_that_an_encoding_lacks_are_escaped_and_json_stays_valid(encoding):
    assert json.loads(printed(f"print(json.dumps({LETTERS!r}, ensure_ascii=False))", encoding)) == LETTERS
    shown = printed(f"from e4dgs.pipeline import say; say({LETTERS!r})", encoding)
    assert "\\udcff" in shown and ("²" in shown) == (encoding in ("latin-1", "cp1252", "utf-8")), shown


def test_a_command_shows_a_name_that_the_encoding_lacks(cli, capture, tmp_path):
    folder = capture.rename(capture.parent / "球²")
    words = [sys.executable, "-m", "e4dgs.workflows.cli", "plan", str(folder), "--json", "--workspace", str(tmp_path / "ws")]
    done = subprocess.run(words, capture_output=True, env={**os.environ, "PYTHONIOENCODING": "ascii"})
    assert done.returncode == 0 and json.loads(done.stdout.decode("ascii"))["scene"] == "球²", done.stderr


def test_the_page_of_the_player_is_made_where_files_are_not_utf_8_by_default():
    code = "from e4dgs.workflows.player.page import page; print(len(page('t', 'scene.e4dw', b'', (0, 0, 0), True)))"
    assert int(printed(code, "ascii", LC_ALL="C", PYTHONCOERCECLOCALE="0", PYTHONUTF8="0")) > 1000


@pytest.mark.parametrize(("columns", "lines"), [(None, 1), ("60", 2), ("wide", 1)])
def test_a_row_of_a_table_is_one_line_in_a_log(capture, tmp_path, columns, lines):
    environment = {key: value for key, value in os.environ.items() if key != "COLUMNS"} | ({"COLUMNS": columns} if columns else {})
    words = [sys.executable, "-m", "e4dgs.workflows.cli", "plan", str(capture), "--workspace", str(tmp_path / "ws")]
    done = subprocess.run(words, capture_output=True, text=True, env=environment)
    shown = done.stdout.splitlines()
    (begin,) = [k for k, line in enumerate(shown) if line.startswith("flow ")]
    end = next(k for k, line in enumerate(shown) if k > begin and not line.startswith(" "))
    assert (end - begin == 1) == (lines == 1), done.stdout
