"""Keys hold the source that a stage's run reaches: what is edited there reruns it, and nothing else does."""

from json import JSONDecoder

import pytest
from e4dgs.pipeline import Graph, Runner, Stage, StageError, explain, make_plan
from e4dgs.pipeline.code.native_source import LIST, read_native, write_list
from e4dgs.pipeline.code.parse_cache import cache_file
from e4dgs.pipeline.code.python_source import read_python
from e4dgs.pipeline.code.reach import code_now, code_of
from e4dgs.pipeline.records import changed_files, differences
from toy_package import EMPTY, REACHED, Toys


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("E4DGS_CACHE", str(tmp_path / "cache"))


@pytest.fixture
def toys(tmp_path):
    toys = Toys(tmp_path)
    yield toys
    toys.close()


def test_what_a_run_reaches(toys):
    assert set(toys.code()["files"]) == REACHED - EMPTY


EDITS = {
    "a constant": ("work/multiply.py", "1_000", "1_001"),
    "logic": ("work/multiply.py", "min(", "max("),
    "a default of a setting": ("stage.py", "Field(2", "Field(3"),
    "a range of a setting": ("stage.py", "ge=0", "ge=1"),
    "a base class": ("base.py", "pass", "x = 1"),
    "what a lazy package finds": ("tools/tool.py", "times(a, b)\n", "times(b, a)\n"),
    "what a program imports": ("work/steps.py", "return x", "return -x"),
    "a kernel": ("fast/cpu/times.cpp", "a * b", "b * a"),
    "a kernel's header": ("fast/cpu/times.h", "int b)", "long b)"),
    "a kernel's flags": ("fast/cpu/CMakeLists.txt", "-O3", "-O2"),
}


@pytest.mark.parametrize("edit", EDITS)
def test_an_edit_of_what_is_reached_is_another_code_and_is_named(toys, edit):
    before = toys.code()
    toys.edit(*EDITS[edit])
    after = toys.code()
    assert before["digest"] != after["digest"]
    assert changed_files(before, after) == [f"{EDITS[edit][0]} has changed"]


NO_EDITS = {
    "a comment": ("stage.py", "# a comment", "# another"),
    "a docstring": ("work/multiply.py", "The product.", "What comes out."),
    "a docstring of a class": ("stage.py", '"""Multiplies."""', '"""Multiplies, and is longer."""'),
    "formatting": ("work/multiply.py", "min(Tool().times(a, b), LIMIT", "min(\n        Tool().times(\n            a, b), (LIMIT)"),
    "another way to write a number": ("work/multiply.py", "1_000", "1000"),
    "what describes a setting": ("stage.py", "by what is multiplied", "the factor"),
    "what only plans ask": ("stage.py", "return 1.5", "return 2.5"),
    "what only plans import": ("planning.py", "because", "just so"),
    "what only type checkers import": ("types_only.py", "1", "2"),
    "what nobody imports": ("nobody.py", "1", "2"),
    "another name of a lazy package": ("tools/other.py", "pass", "x = 1"),
    "a lazy package that offers more": ("tools/__init__.py", '"Other": ".other"', '"Other": ".other", "Third": ".third"'),
    "the package's version": ("__init__.py", '"1"', '"2"'),
    "a kernel's comment": ("fast/cpu/times.cpp", "// a comment", "/* another\n // one */"),
    "a kernel's white space": ("fast/cpu/times.cpp", "{ return a * b; }", "{\n  return a * b;\n}"),
    "a comment about flags": ("fast/cpu/CMakeLists.txt", "# flags", "# options"),
    "a kernel of the GPU": ("fast/times.cu", "{}", "{ ; }"),
}


@pytest.mark.parametrize("edit", NO_EDITS)
def test_an_edit_of_anything_else_changes_nothing(toys, edit):
    before = toys.code()
    toys.edit(*NO_EDITS[edit])
    assert toys.code() == before


def test_kernels_of_the_gpu_count_where_a_reached_file_lies_beside_them(toys):
    before, on_cpu = toys.code(cuda=True), toys.code()
    assert set(before["files"]) - set(on_cpu["files"]) == {"fast/times.cu", "shared/both.h"}
    toys.edit("shared/both.h", "2", "3")
    assert changed_files(before, toys.code(cuda=True)) == ["shared/both.h has changed"] and toys.code() == on_cpu


def test_a_file_that_moves_changes_no_key(toys):
    """Its package has an own __init__.py, and the imports in it and of it have other dots."""
    before = toys.code()
    toys.write("deep/er/__init__.py", "")
    toys.write("deep/__init__.py", '"""Deep."""')
    (toys.root / "work" / "multiply.py").rename(toys.root / "deep" / "er" / "product.py")
    toys.edit("deep/er/product.py", "from ..tools", "from ...tools")
    toys.edit("deep/er/product.py", "from . import", "from ...work import")
    toys.edit("stage.py", "from .work.multiply", "from .deep.er.product")
    after = toys.code()
    assert after["digest"] == before["digest"] and "deep/er/product.py" in after["files"]
    assert differences({"code": before}, {"code": after}) == []
    toys.write("fast/a/all.cpp", (toys.root / "fast" / "cpu" / "times.cpp").read_text())
    (toys.root / "fast" / "cpu" / "times.cpp").unlink()
    (toys.root / "fast" / "cpu" / "times.h").rename(toys.root / "fast" / "a" / "times.h")
    assert toys.code()["digest"] == before["digest"]


def test_an_import_from_elsewhere_is_another_code(toys):
    """Of two files that are reached before and after, and of two that are alike but for where they have a name from."""
    toys.write("one.py", "from .base import Base as multiply\nfrom .nobody import CONSTANT\n")
    toys.write("two.py", "from .nobody import CONSTANT as multiply\nfrom .base import Base\n")
    toys.edit("stage.py", "from .work.multiply", "from . import one, two\n        from .one")
    before = toys.code()
    toys.edit("stage.py", "from .one", "from .two")
    assert changed_files(before, toys.code()) == ["source files import one another differently"]
    for name in ("one", "two"):
        toys.write(f"{name}.py", f"from .{'nobody' if name == 'one' else 'planning'} import multiply\n")
    before = toys.code()
    toys.edit("stage.py", "from .two", "from .one")
    assert before["files"] == toys.code()["files"] and before["digest"] != toys.code()["digest"]


def test_files_that_come_and_go_are_named_and_long_lists_are_cut(toys):
    before = toys.code()
    toys.edit("stage.py", "from .work.multiply import multiply", "from .nobody import CONSTANT as multiply")
    gone = sorted(REACHED - EMPTY - {"stage.py", "base.py"})
    assert changed_files(before, toys.code()) == [
        "stage.py has changed",
        "nobody.py is new",
        f"{', '.join(gone[:4])} and {len(gone) - 4} more are gone",
    ]
    assert changed_files({"digest": "1", "files": {"a": "1", "b": "1"}}, {"digest": "2", "files": {"a": "2", "b": "2"}}) == [
        "a and b have changed"
    ]


def test_what_a_lazy_package_does_not_tell_may_be_any_of_its_files(toys):
    toys.write("tools/__init__.py", "def __getattr__(name):\n    return find(name)\n")
    assert {"tools/tool.py", "tools/other.py"} <= set(toys.code()["files"])


def test_a_module_without_source_counts_byte_for_byte(toys):
    toys.edit("fast/__init__.py", "from ._native", "from ..closed._native")
    toys.write("closed/__init__.py", "")
    toys.write("closed/_native.abi3.so", "machine code")
    before = toys.code()
    assert "closed/_native.abi3.so" in before["files"] and "fast/cpu/times.cpp" not in before["files"]
    toys.write("closed/_native.abi3.so", "other machine code")
    assert changed_files(before, toys.code()) == ["closed/_native.abi3.so has changed"]


def test_a_stage_of_another_package_counts_what_it_takes_of_ours_but_not_the_engine(toys):
    toys.edit("work/multiply.py", "from . import program", "from e4dgs.vision.images.png import encode_png")
    toys.edit("work/multiply.py", "program.__name__", "encode_png.__name__")
    files = set(toys.code()["files"])
    assert "e4dgs/vision/images/png.py" in files and not [file for file in files if "pipeline" in file]


def test_an_installed_package_counts_as_its_sources_did(toys):
    """It has the list that the build wrote, and no C++ sources; what was edited since is not in the compiled module yet."""
    before, on_gpu = toys.code(), toys.code(cuda=True)
    write_list(toys.root, toys.root / LIST)
    toys.edit("fast/cpu/times.cpp", "a * b", "b * a")
    assert toys.code() == before
    for path in (toys.root / "fast" / "cpu").iterdir():
        path.unlink()
    assert toys.code() == before and toys.code(cuda=True) == on_gpu
    toys.edit("fast/times.cu", "{}", "{ ; }")
    assert toys.code() == before
    assert changed_files(on_gpu, toys.code(cuda=True)) == ["fast/times.cu has changed"], "these are compiled when they run"


def test_what_a_stage_derives_from_counts_where_it_is_ours(toys):
    """Python's own and other libraries' classes do not."""
    before = toys.code()
    toys.stage = type("Derived", (toys.stage, JSONDecoder), {"__module__": toys.stage.__module__})
    assert toys.code() == before


def test_a_stage_that_is_in_no_file_is_refused():
    alone = type("Alone", (Stage,), {"name": "alone", "__module__": "nowhere"})
    with pytest.raises(StageError, match="Alone: its source is not in a file"):
        code_of(alone)


def test_a_plan_names_the_file_and_a_run_makes_it_again(bench, toys, monkeypatch):
    job = lambda: bench.job(*Graph([toys.stage()]))  # noqa: E731
    monkeypatch.setattr("e4dgs.pipeline.keys.code_of", code_now)  # as in a process that begins anew
    monkeypatch.setattr("e4dgs.pipeline.code.edited.code_of", code_now)
    assert Runner(job()).run()[0].state == "ran"
    toys.edit(*NO_EDITS["a comment"])
    assert explain(job(), "toy") == ["toy would be reused: nothing changed"]
    toys.edit(*EDITS["a kernel"])
    toys.edit(*EDITS["a constant"])
    assert explain(job(), "toy") == ["toy would run: fast/cpu/times.cpp and work/multiply.py have changed"]
    assert Runner(job()).run()[0].state == "ran" and make_plan(job())[0].state == "cached"
    toys.edit("work/multiply.py", "1_001", "1_000")
    toys.edit("fast/cpu/times.cpp", "b * a", "a * b")
    assert make_plan(job())[0].reason == "was made before with the same inputs and settings"


def test_a_run_whose_source_is_edited_meanwhile_ends_before_the_stage_that_reaches_it(bench, toys):
    job = bench.job(*Graph([toys.stage()]))
    assert make_plan(job)[0].state == "run"
    toys.edit(*NO_EDITS["a comment"])
    toys.edit(*EDITS["logic"])
    with pytest.raises(StageError, match=r"^toy: work/multiply.py has changed since this run began; run it again"):
        Runner(job).run()
    assert bench.store.entries() == []


@pytest.mark.parametrize("damage", ["cut", "flipped", "no json", "a folder"])
def test_a_damaged_cache_is_made_again(toys, damage):
    before, path = toys.code(), cache_file()
    whole = path.read_bytes()
    if damage == "a folder":
        path.unlink()
        path.mkdir()
    else:
        spoiled = {"cut": whole[:-100], "flipped": whole.replace(b'"imports"', b'"exports"'), "no json": b"x" * 64 + b"\n{"}
        path.write_bytes(spoiled[damage])
    assert toys.code() == before
    assert path.is_dir() or path.read_bytes() == whole


def test_the_cache_saves_parsing_and_knows_when_it_is_read_otherwise(toys, monkeypatch):
    before = toys.code()

    def parse(data: bytes) -> None:
        raise AssertionError("is parsed again")

    monkeypatch.setattr("e4dgs.pipeline.code.parse_cache.read_python", parse)
    assert toys.code() == before
    monkeypatch.setattr("e4dgs.pipeline.code.parse_cache._readers", lambda: "another")
    with pytest.raises(AssertionError, match="parsed again"):
        toys.code()


def test_a_file_of_python_counts_the_same_in_every_version():
    """By 3.11, 3.12 and 3.13: dumps of syntax trees differ between these, and what we write down must not."""
    text = '''
from __future__ import annotations
import numpy as np, os.path as p
from .a import b as c
@decorated(x=1)
async def f(a, /, b: int = 1_0, *c, d=None, **e) -> list[int]:
    """Said."""
    async with a as b, c: yield await b
    return [x async for x in y if x not in {*z}] or (lambda: ...) or f"{a!r:>{b}} {c=}" or 1e3 or 2j or b"\\x00"
class A(B, metaclass=C):
    x: int = 3
    match x:
        case {"k": [1, *_], **rest} | A(y=-1) if (w := 2) > 1: del x[1:2, ::3]
        case _: raise E from None
try: assert a, "é"
except* (V, W) as g: global h
else: i, *j = k
finally: l @= m
'''
    found = read_python(text.encode())
    assert found.digest == "4997d43417cc03be32a738edcc2c671d03c34f726a923c3691cb9e9c12a83cf3"
    assert found.imports == [(0, "__future__", ["annotations"]), (0, "numpy", []), (0, "os.path", []), (1, "a", ["b"])]


def test_what_cannot_be_parsed_counts_byte_for_byte():
    assert read_python(b"def (").digest != read_python(b"def ( ").digest


@pytest.mark.parametrize(
    ("one", "two", "same"),
    [
        ("f( x ){ // c\n return 1'000; }", "f(x) {\n  return 1'000; /* 'x */\n}", True),
        ('x = "//a";  // "', 'x = "//a";', True),
        ("#define A \\\n 1\nint b;", "#define  A 1\nint\nb;", True),
        ("a+++b", "a++ +b", False),
        ("#define A x\n+y", "#define A x +y", False),
        ('x = "a  b";', 'x = "a b";', False),
        ("c = '\"'; // one", "c = '\"'; // two", True),
        ('R"(// a)"', 'R"(// b)"', False),
    ],
)
def test_what_counts_of_a_native_source(one, two, same):
    assert (read_native("a.cpp", one.encode()) == read_native("a.cpp", two.encode())) is same
