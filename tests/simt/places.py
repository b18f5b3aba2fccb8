"""Names for the addresses in what the native side says: `<0x..>`, an instruction, and `{0x..}`, a byte of shared memory."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

OWN = str(Path(__file__).resolve().parent / "atomics.h")


def with_names(said: str, library: Path) -> str:
    """The text with lines of the source and names of variables, where binutils is there to find them."""
    said = re.sub(r"<(0x[0-9a-f]+)>", lambda found: line(library, found[1]), said)
    return re.sub(r"\{(0x[0-9a-f]+)\}", lambda found: variable(library, int(found[1], 16)), said)


def line(library: Path, offset: str) -> str:
    """The place of an instruction: of inlined functions the innermost that is not the emulator's."""
    places = [found.split()[0] for found in asked("addr2line", "-ie", str(library), offset) if not found.startswith(OWN)]
    return Path(places[0]).name if places else f"{library.name}+{offset}"


def variable(library: Path, offset: int) -> str:
    """`byte 4 of kept`. A library's thread-local symbols are its shared variables (see simt.h), with offsets for values."""
    for symbol in asked("readelf", "-sWC", str(library)):
        words = symbol.split(maxsplit=7)
        if len(words) == 8 and words[3] == "TLS":
            start, size = int(words[1], 16), int(words[2], 0)
            if start <= offset < start + size:
                return f"byte {offset - start} of {words[7].rpartition('::')[2]}"
    return f"byte {offset} of shared memory"


def asked(*command: str) -> list[str]:
    try:
        return subprocess.run(command, capture_output=True, text=True).stdout.splitlines()
    except OSError:
        return []
