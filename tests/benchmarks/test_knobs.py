"""benchmarks/knobs.py changes one line of the kernels' sources for each variant, and finds it."""

from pathlib import Path

import pytest
from script_module import load_script

ROOT = Path(__file__).resolve().parents[2]
knobs = load_script(ROOT / "benchmarks" / "knobs.py")


@pytest.mark.parametrize("name", knobs.VARIANTS)
def test_a_variant_differs_from_the_sources_in_one_line(tmp_path, name):
    variant = knobs.VARIANTS[name]
    knobs.copy_sources(tmp_path, variant)
    changed = []
    for path in (path for path in tmp_path.rglob("*") if path.is_file()):
        before, after = (ROOT / path.relative_to(tmp_path)).read_text().splitlines(), path.read_text().splitlines()
        changed += [path.relative_to(tmp_path).as_posix() for old, new in zip(before, after, strict=True) if old != new]
    assert changed == ([] if variant is None else [variant.path])
    assert (tmp_path / "rasterizer" / "cpu" / "CMakeLists.txt").is_file()


def test_sources_that_have_changed_are_one_message(tmp_path):
    with pytest.raises(SystemExit, match=r"records\.h does not have 'kTile = 7;' once"):
        knobs.copy_sources(tmp_path, knobs.Variant("rasterizer/cpu/records.h", "kTile = 7;", "kTile = 8;"))
