"""Puts the instrumented kernels in place of the installed ones, in every process that `dev.py sanitize` starts.

Python imports a module of this name at its start, where the folder is on PYTHONPATH. All other modules of the package come from where
they always come from.
"""

import importlib.util
import os
import sys
from pathlib import Path

FOLDER = Path(os.environ["E4DGS_SANITIZED"])
FILES = {
    f"e4dgs.{floor}.{name}": next((FOLDER / "e4dgs" / floor).glob(name + ".*"))
    for floor, name in (("rasterizer", "_cpu"), ("scene", "_kernels"), ("vision", "_kernels"))
}


class Instrumented:
    @staticmethod
    def find_spec(name, path=None, target=None):
        return importlib.util.spec_from_file_location(name, FILES[name]) if name in FILES else None


sys.meta_path.insert(0, Instrumented)
