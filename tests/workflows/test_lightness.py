"""Help, plans and cached runs answer at once: none of the heavy libraries is imported."""

import json
import subprocess
import sys

import pytest

HEAVY = ("torch", "cv2", "scipy", "pycolmap", "open3d", "kornia")


def imported_by(*arguments: str) -> list[str]:
    """Heavy modules that a command has imported when it ends, in a process of its own."""
    code = (
        "import json, sys\n"
        "from e4dgs.workflows.cli import main\n"
        f"code = main({list(arguments)!r})\n"
        f"print('\\n' + json.dumps([code, [name for name in {HEAVY!r} if name in sys.modules]]))"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    code, heavy = json.loads(result.stdout.splitlines()[-1])
    assert code == 0, result.stdout + result.stderr
    return heavy


@pytest.mark.parametrize(
    "command",
    [
        "--help",
        "run --help",
        "plan --help",
        "bench --help",
        "bench raster --list",
        "export flow --help",
        "export usd --help",
        "export mesh --help",
    ],
)
def test_help_imports_nothing_heavy(command):
    assert imported_by(*command.split()) == []


def test_a_plan_imports_nothing_heavy(dnerf_capture, images_capture, tmp_path):
    for capture in (dnerf_capture, images_capture):
        assert imported_by("plan", str(capture.root), "--workspace", str(tmp_path / "w"), "--json") == []


def test_a_cached_stage_imports_nothing_heavy(dnerf_capture, tmp_path):
    arguments = ("run", "frames", str(dnerf_capture.root), "--workspace", str(tmp_path / "w"))
    imported_by(*arguments)
    assert imported_by(*arguments) == []
