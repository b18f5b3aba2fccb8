"""A full workspace: every command that writes ends with one message that has path and bytes, and goes on once there is room."""

import shutil

import pytest
from small_disk import small_disk


@pytest.fixture
def disk(tmp_path):
    with small_disk(tmp_path / "disk", 1 << 20) as mounted:
        yield mounted


def test_run_pin_and_batch_say_so_and_go_on_once_there_is_room(cli, capture, disk):
    workspace = disk.path / "workspace"
    for room in (0, 2, 6, 12):
        filler = disk.fill(4096 * room)
        result = cli("run", "all", capture, "--workspace", workspace)
        assert result.code == 1 and result.err.count("error: ") == 1 == result.err.count("\n"), result.err
        assert str(disk.path) in result.err and "No space left on device" in result.err and " bytes are free in " in result.err
        filler.unlink()
        shutil.rmtree(workspace, ignore_errors=True)
    assert cli("run", "all", capture, "--workspace", workspace).code == 0
    filler = disk.fill(0)
    for words in (("run", "fine", capture, "--set", "fine.iterations=12"), ("pin", "my-scene"), ("batch", capture)):
        result = cli(*words, "--workspace", workspace)
        assert result.code == 1 and str(disk.path) in result.err and " bytes are free in " in result.err, (words, result.err)
    for words in (("plan", capture), ("list",), ("verify",)):
        assert cli(*words, "--workspace", workspace).code == 0, "what only reads needs no room"
    filler.unlink()
    assert cli("run", "all", capture, "--workspace", workspace).code == 0
    assert cli("pin", "my-scene", "--workspace", workspace).code == 0


def test_gc_makes_room_on_a_full_disk(cli, capture, disk):
    workspace = disk.path / "workspace"
    assert cli("run", "all", capture, "--workspace", workspace).code == 0
    assert cli("run", "all", capture, "--workspace", workspace, "--set", "fine.iterations=12").code == 0
    disk.fill(0)
    result = cli("gc", "--workspace", workspace)
    assert result.code == 0 and "removed fine/" in result.out, result.out + result.err
    assert cli("verify", "--workspace", workspace).code == 0
