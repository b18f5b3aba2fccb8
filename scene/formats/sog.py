"""What a SOG file (PlayCanvas, version 2) says of the renderers that it is meant for."""

from __future__ import annotations

import io
import json
import zipfile

META = "meta.json"


def tagged_sog(file: bytes, antialiased: bool) -> bytes:
    """``file`` with "antialias" in its meta.json, and if that is true also "model", which splat-transform reads and writes (3.2 and
    later)."""
    made = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(file)) as old, zipfile.ZipFile(made, "w", zipfile.ZIP_STORED) as new:
        for entry in old.infolist():
            data = old.read(entry)
            if entry.filename == META:
                said = {"antialias": antialiased, **({"model": "antialiased"} if antialiased else {})}
                data = json.dumps(json.loads(data) | said).encode()
            new.writestr(zipfile.ZipInfo(entry.filename), data)
    return made.getvalue()
