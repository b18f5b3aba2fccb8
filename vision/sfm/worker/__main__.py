"""The process that holds pycolmap: `python -m e4dgs.vision.sfm.worker REQUEST.json`.

Writes `result.npz` (arrays) and `result.json` (facts) to the request's folder, and one JSON line per step of progress to stdout.
It ends when its stdin closes, so that it never outlives the program that started it.
"""

from __future__ import annotations

import json
import os
import sys
import threading
from pathlib import Path


def _leave_with_parent() -> None:
    while os.read(0, 4096):  # not sys.stdin: its lock would be held while the interpreter ends
        pass
    os._exit(3)


def _report(phase: str, done: int, total: int) -> None:
    print(json.dumps({"phase": phase, "done": done, "total": total}), flush=True)


def main(request_file: str) -> None:
    threading.Thread(target=_leave_with_parent, daemon=True).start()
    import numpy as np

    from ....pipeline.files import write_atomically

    request = json.loads(Path(request_file).read_text(encoding="utf-8"))
    if request["task"] == "reconstruct":
        from .reconstruct import reconstruct as task
    elif request["task"] == "reconstruct_masked":
        from .masked import reconstruct_masked as task
    elif request["task"] == "reconstruct_rig":
        from .rig import reconstruct_rig as task
    elif request["task"] == "match":
        from .features.matching import match_share as task
    elif request["task"] == "triangulate":
        from .known_poses import triangulate_known as task
    else:
        raise SystemExit(f"{request_file}: unknown task {request['task']!r}")
    arrays, facts = task(request, _report)
    folder = Path(request["folder"])
    np.savez(folder / "result.npz", allow_pickle=False, **arrays)
    write_atomically(folder / "result.json", json.dumps(facts))  # written last, so if the facts are there, the arrays are too


if __name__ == "__main__":
    main(sys.argv[1])
