"""Numbered files of an export, one per time: ``frame0001.ply`` and so on, and ``sequence.json``, which lists them. A folder has the whole
of a new sequence, or the earlier one."""

from __future__ import annotations

import fcntl
import json
import os
import re
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Literal

SplatFormat = Literal["ply", "compressed-ply", "spz", "sog", "gltf"]
KINDS: dict[SplatFormat, str] = {"ply": ".ply", "compressed-ply": ".compressed.ply", "spz": ".spz", "sog": ".sog", "gltf": ".glb"}
INDEX = "sequence.json"
MOST_INDEX = 1 << 24  # bytes
PART = ".export-"  # begins the name of the folder that holds files until all are written


def numbered(folder: Path, k: int, ending: str) -> Path:
    """The file of time ``k``, from 0, with an ending such as ``.ply``."""
    return folder / f"frame{k + 1:04d}{ending}"


def sequence_in(folder: Path, ending: str) -> list[Path]:
    """The files of a sequence in ``folder``, in order. Only files with exactly such a name count."""
    name = re.compile(rf"frame([0-9]{{4,}}){re.escape(ending)}")
    found = {int(match[1]): file for file in folder.iterdir() if (match := name.fullmatch(file.name)) is not None}
    return [file for k, file in sorted(found.items()) if file == numbered(folder, k - 1, ending) and file.is_file()]


def strangers(folder: Path, ending: str) -> list[str]:
    """Names of numbered files in ``folder`` that readers of a sequence with this ``ending`` would take for a part of it, and that our index
    does not list as such a sequence."""
    if not folder.is_dir():
        return []
    last = re.escape("." + ending.rpartition(".")[2])
    name = re.compile(rf".*[0-9](\.[a-z]+)?{last}", re.IGNORECASE)
    own = {file.name for file in listed(folder, ending)}
    return sorted(one.name for one in folder.iterdir() if name.fullmatch(one.name) and one.name not in own and one.is_file())


def listed(folder: Path, ending: str) -> list[Path]:
    """The files of a sequence that the index in ``folder`` lists and that are there, in the folder itself."""
    rows = indexed(folder).get(ending, {}).get("files", [])
    own = [row.get("file") for row in rows if isinstance(row, dict)] if isinstance(rows, list) else []
    return [file for file in folder.iterdir() if file.name in own and file.is_file()]


def indexed(folder: Path) -> dict[str, dict[str, Any]]:
    """The sequences that the index in ``folder`` describes, by the ending of their files; none without an index."""
    file = folder / INDEX
    try:
        found = json.loads(file.read_bytes()) if file.stat().st_size <= MOST_INDEX else {}
    except (OSError, ValueError, RecursionError):
        return {}
    return {key: one for key, one in found.items() if isinstance(one, dict)} if isinstance(found, dict) else {}


def write_index(folder: Path, ending: str, moments: Sequence[float], span: float, about: Mapping[str, Any]) -> None:
    """Writes what a sequence in ``folder`` is: ``about``, the rate, its files, and the time of each in [0, 1] and in seconds. span: seconds
    from time 0 to time 1, 0 if unknown."""
    rows = [{"file": numbered(folder, k, ending).name, "time": t, "seconds": t * span} for k, t in enumerate(moments)]
    rate = (len(moments) - 1) / span if span > 0 and len(moments) > 1 else None
    (folder / INDEX).write_text(json.dumps({ending: {**about, "rate": rate, "files": rows}}, indent=1) + "\n")


@contextmanager
def new_sequence(folder: Path, ending: str) -> Iterator[Path]:
    """A folder for the files of a sequence, which at the end go to ``folder`` in place of those that an earlier export left there, with an
    index if the block has written one (`write_index`).

    If the block is left by an error or Ctrl-C, nothing has changed. If the process is killed while files go to ``folder``, the first of the
    sequence is missing, so that nothing takes the rest for a whole one. Raises OSError if a file cannot be written, moved or removed.
    """
    with staged(folder) as part:
        yield part
        made = sequence_in(part, ending)
        for file in sequence_in(folder, ending):  # the first one first
            file.unlink()
        if new := indexed(part):  # beside sequences of other kinds
            (part / INDEX).write_text(json.dumps(indexed(folder) | new, indent=1) + "\n")
            os.replace(part / INDEX, folder / INDEX)
        for file in reversed(made):  # the first one last
            os.replace(file, folder / file.name)


@contextmanager
def staged(folder: Path) -> Iterator[Path]:
    """A hidden folder inside ``folder``, which is made if it is not there, for files that are not complete. It goes at the end, and the
    folders that were made for it go if nothing came into them."""
    made = [folder, *folder.parents][: next(k for k, one in enumerate([folder, *folder.parents]) if one.exists())]
    folder.mkdir(parents=True, exist_ok=True)
    _remove_leftovers(folder)
    part = Path(tempfile.mkdtemp(prefix=PART, dir=folder))
    held = os.open(part, os.O_RDONLY)
    try:
        with suppress(OSError):  # some file systems have no locks
            fcntl.flock(held, fcntl.LOCK_SH)
        yield part
    finally:
        os.close(held)
        shutil.rmtree(part, ignore_errors=True)
        for one in made:
            try:
                one.rmdir()
            except OSError:  # it has files now
                break


def _remove_leftovers(folder: Path) -> None:
    """Removes what exports that were killed have left in ``folder``: their lock is gone."""
    for part in folder.glob(f"{PART}*"):
        held = os.open(part, os.O_RDONLY)
        try:
            fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
            shutil.rmtree(part, ignore_errors=True)
        except OSError:  # another export is at work
            continue
        finally:
            os.close(held)
