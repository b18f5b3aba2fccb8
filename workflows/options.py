"""The options that are common to all commands about a capture, each defined and explained once."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Capture = Annotated[Path, typer.Argument(metavar="CAPTURE", help="A video, a folder of images, or a folder with poses.")]
Captures = Annotated[list[Path], typer.Argument(metavar="CAPTURE...", help="Captures, as `run` takes them.")]
Workspace = Annotated[Path, typer.Option("--workspace", help="Folder that holds store/ and scenes/.")]
Preset = Annotated[str, typer.Option("--preset", help="Named set of settings: default, fast, best.")]
Set = Annotated[list[str] | None, typer.Option("--set", metavar="STAGE.KEY=VALUE", help="A setting of a stage; may be repeated.")]
Device = Annotated[str, typer.Option("--device", help="auto, cpu or cuda.")]
Name = Annotated[str | None, typer.Option("--name", help="Name of the scene; the capture's own name by default.")]
Static = Annotated[bool, typer.Option("--static", help="Nothing moves in this capture.")]
Format = Annotated[str | None, typer.Option("--format", help="Format of the capture, if its files fit several.")]
StoreAlso = Annotated[
    list[Path] | None,
    typer.Option("--store-also", metavar="DIR", help="Another workspace, which is only read: its results are reused; may be repeated."),
]
Debug = Annotated[bool, typer.Option("--debug", help="Show a traceback with an error.")]
