"""Every Python that has this folder first on its PYTHONPATH finds toy stages where the reconstruction is: for tests of batches, whose
stages run in processes of their own, on nodes of their own."""

import contextlib
import importlib.util
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
TOYS = ("e4dgs.workflows.reconstruction", "e4dgs.stages.report.page")


class Toys:
    @staticmethod
    def find_spec(name, path=None, target=None):
        return importlib.util.spec_from_file_location(name, HERE / "toy_stages_of_a_batch.py") if name in TOYS else None


sys.meta_path.insert(0, Toys)

# The environment's own, which this file hides.
sys.path[:] = [place for place in sys.path if Path(place or ".").resolve() != HERE]
this = sys.modules.pop("sitecustomize")
with contextlib.suppress(ImportError):
    import sitecustomize  # noqa: F401
sys.modules.setdefault("sitecustomize", this)  # the import of this file ends by looking for it
