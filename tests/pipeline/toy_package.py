"""A package with a stage, as a user may write it, in a folder where its files can be edited: `toys/stage.py` and what its run reaches."""

from __future__ import annotations

import sys
from importlib import import_module, invalidate_caches
from pathlib import Path
from typing import Any

from e4dgs.pipeline import Stage
from e4dgs.pipeline.code.reach import code_now

FILES = {
    "__init__.py": '"""Toys."""\n__version__ = "1"\n',
    "stage.py": '''
"""A stage."""
from __future__ import annotations
from typing import TYPE_CHECKING
from e4dgs.pipeline import Applies, Settings, Stage
from pydantic import Field
from .base import Base
if TYPE_CHECKING:
    from .types_only import Thing

class ToySettings(Settings):
    factor: int = Field(2, ge=0, description="by what is multiplied")

class Toy(Base, Stage):
    """Multiplies."""
    name = "toy"
    settings = ToySettings

    def applies(self, facts, settings):
        from .planning import reason
        return Applies.yes(reason)

    def estimate(self, facts, settings):
        return 1.5

    def run(self, ctx):
        from .work.multiply import multiply
        ctx.out.attrs["result"] = multiply(3, ctx.settings.factor)  # a comment
''',
    "base.py": "class Base:\n    pass\n",
    "types_only.py": "Thing = 1\n",
    "planning.py": "reason = 'because'\n",
    "nobody.py": "CONSTANT = 1\n",
    "work/__init__.py": '"""Work."""\n',
    "work/multiply.py": '''
from ..tools import Tool
from . import program

LIMIT = 1_000


def multiply(a: int, b: int) -> int:
    """The product."""
    return min(Tool().times(a, b), LIMIT, len(program.__name__))
''',
    "work/program/__init__.py": "",
    "work/program/__main__.py": "from ..steps import first\n\nfirst(1)\n",
    "work/steps.py": "def first(x):\n    return x\n",
    "tools/__init__.py": """
from importlib import import_module
_PUBLIC = {"Tool": ".tool", "Other": ".other"}
__all__ = sorted(_PUBLIC)
def __getattr__(name):
    return getattr(import_module(_PUBLIC[name], __name__), name)
""",
    "tools/tool.py": "from .. import fast\n\n\nclass Tool:\n    def times(self, a, b):\n        return fast.times(a, b)\n",
    "tools/other.py": "class Other:\n    pass\n",
    "fast/__init__.py": """
try:
    from ._native import times
except ImportError:  # is not built
    def times(a, b):
        return a * b
""",
    "fast/cpu/times.cpp": '#include "times.h"\nint times(int a, int b) { return a * b; }  // a comment\n',
    "fast/cpu/times.h": "#pragma once\nint times(int a, int b);\n",
    "fast/cpu/CMakeLists.txt": "# flags\nadd_compile_options(-O3)\n",
    "fast/cuda.py": "",
    "fast/times.cu": '#include "../shared/both.h"\n__global__ void times() {}\n',
    "shared/__init__.py": "",
    "shared/both.h": "constexpr int BOTH = 2;\n",
}
REACHED = {
    *("__init__.py", "stage.py", "base.py", "work/multiply.py", "work/program/__main__.py", "work/steps.py", "tools/__init__.py"),
    *("tools/tool.py", "fast/__init__.py", "fast/cpu/times.cpp", "fast/cpu/times.h", "fast/cpu/CMakeLists.txt"),
}
EMPTY = {"__init__.py"}  # holds no code


class Toys:
    """The package in a folder."""

    def __init__(self, root: Path) -> None:
        self.root = root / "toys"
        for name, text in FILES.items():
            self.write(name, text)
        sys.path.insert(0, str(root))
        invalidate_caches()
        self.stage: type[Stage] = import_module("toys.stage").Toy

    def close(self) -> None:
        sys.path.remove(str(self.root.parent))
        for name in [name for name in sys.modules if name.partition(".")[0] == "toys"]:
            del sys.modules[name]

    def write(self, name: str, text: str) -> None:
        (self.root / name).parent.mkdir(parents=True, exist_ok=True)
        (self.root / name).write_text(text)

    def edit(self, name: str, old: str, new: str) -> None:
        text = (self.root / name).read_text()
        assert text.count(old) == 1, f"{name}: {old!r}"
        self.write(name, text.replace(old, new))

    def code(self, cuda: bool = False) -> dict[str, Any]:
        return code_now(self.stage, cuda)
