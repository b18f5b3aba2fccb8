"""The `evaluate` artifact: metrics, and pictures and movies for the report."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...pipeline import Artifact, ArtifactWriter

MOVIES = ("over_time", "turntable")


@dataclass
class StoredPictures:
    """Pictures by name, in order, as PNG files, and what they show.

    Names are "<split>/<frame>/truth|render|error|edges|depth", "strip/<k>/render|truth", "flow/<k>/frame|measured|rendered|edges|moving"
    and "flow/wheel".
    """

    files: dict[str, bytes] = field(default_factory=dict)
    views: list[dict[str, Any]] = field(default_factory=list)  # for each view shown: stem, split, name, time, psnr, ssim
    strip: dict[str, Any] = field(default_factory=lambda: {"camera": "", "times": []})  # one held-out camera over time
    flow: dict[str, Any] = field(default_factory=dict)  # largest (px), method, pairs; empty if no flow is shown

    def write(self, out: ArtifactWriter) -> None:
        encoded = list(self.files.values())
        offsets = np.cumsum([0, *map(len, encoded)]).astype(np.int64)
        out.write("png", np.frombuffer(b"".join(encoded), np.uint8), doc="PNG files, one after the other")
        out.write("png_offsets", offsets, unit="byte", doc="where each begins, and the end")
        out.attrs.update(png_names=list(self.files), views=self.views, strip=self.strip)
        if self.flow:
            out.attrs["flow"] = self.flow

    @classmethod
    def read(cls, artifact: Artifact) -> StoredPictures:
        """The stored pictures; empty if there are none."""
        attrs, files = artifact.attrs, {}
        if "png" in artifact:
            data, offsets = artifact.read("png").tobytes(), artifact.read("png_offsets")
            files = {name: data[offsets[k] : offsets[k + 1]] for k, name in enumerate(attrs.get("png_names", []))}
        return cls(files, attrs.get("views", []), attrs.get("strip") or {}, attrs.get("flow") or {})


def write_movie(out: ArtifactWriter, name: str, data: bytes, doc: str) -> None:
    """An MP4 file; ``name`` is one of `MOVIES`."""
    out.write(f"movie_{name}", np.frombuffer(data, np.uint8), doc=f"{doc}; MP4")


def read_movies(artifact: Artifact) -> dict[str, bytes]:
    """MP4 files by name (see `MOVIES`); missing ones are left out."""
    return {name: artifact.read(f"movie_{name}").tobytes() for name in MOVIES if f"movie_{name}" in artifact}


def write_player(out: ArtifactWriter, scene: bytes, poster: bytes) -> None:
    """The scene's file for the web player (docs/player.md), and a JPEG that is shown until the scene is."""
    out.write("player", np.frombuffer(scene, np.uint8), doc="the scene for the web player; see docs/player.md")
    out.write("player_poster", np.frombuffer(poster, np.uint8), doc="JPEG that is shown until the scene is")


def has_player(artifact: Artifact) -> bool:
    """Whether there is a scene for the web player."""
    return "player" in artifact and "player_poster" in artifact


def read_player(artifact: Artifact) -> tuple[bytes, bytes] | None:
    """Inverse of `write_player`; None if there is no scene."""
    if not has_player(artifact):
        return None
    return artifact.read("player").tobytes(), artifact.read("player_poster").tobytes()


def write_metrics(out: ArtifactWriter, metrics: Mapping[str, Any], speed: Mapping[str, Any]) -> None:
    """The part of metrics.json that belongs to evaluation. speed: timings, stored apart from the content."""
    out.attrs["metrics"] = metrics
    out.info["metrics"] = speed


def read_metrics(artifact: Artifact) -> dict[str, Any]:
    """Inverse of `write_metrics`: both in one."""
    return {**artifact.attrs["metrics"], **artifact.info.get("metrics", {})}
