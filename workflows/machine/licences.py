"""`e4dgs doctor --licenses`: the licence of e4dgs, of each package that it asks for, of optional weights and of the sample."""

from __future__ import annotations

from importlib import metadata
from typing import NamedTuple

from .doctor import name_and_extra

LONGEST = 120  # characters; some packages put a whole licence text into the field for its name
OWN = "Apache-2.0"


class Licence(NamedTuple):
    """name: of a package or a file. version: "" for files. terms: an SPDX expression where one is stated. note: what it is for."""

    name: str
    version: str
    terms: str
    note: str = ""


FILES = (
    Licence(
        "RAFT weights",
        "",
        "BSD-3-Clause",
        "optional (flow.weights); trained on FlyingChairs, FlyingThings3D and more, whose data are for research only: "
        "ask their owners before commercial use",
    ),
    Licence("LPIPS heads", "", "BSD-2-Clause", "optional (the extra lpips, or evaluate.lpips_weights); any use"),
    Licence(
        "AlexNet and VGG16 weights",
        "",
        "BSD-3-Clause",
        "optional (with the heads); torchvision's, trained on ImageNet, whose pictures are for non-commercial research",
    ),
    Licence("samples/cube_and_ball", "", "CC0-1.0", "rendered by tests/factory, with no picture of others in it; any use"),
)


def licences() -> list[Licence]:
    """e4dgs, the packages that it asks for on this machine (developer tools left out), then `FILES`. Imports none of the packages."""
    try:
        version, asked = metadata.version("e4dgs"), metadata.requires("e4dgs") or []
    except metadata.PackageNotFoundError:  # it runs from its source folder
        version, asked = "", []
    found: dict[str, Licence] = {}
    for name, extra in filter(None, map(name_and_extra, asked)):
        if extra != "dev":
            found.setdefault(name, _of_package(name, "" if extra is None else f"extra {extra}"))
    return [Licence("e4dgs", version, OWN), *found.values(), *FILES]


def _of_package(name: str, note: str) -> Licence:
    try:
        about = metadata.metadata(name)
    except metadata.PackageNotFoundError:
        return Licence(name, "", "not installed", note)
    field = {key: about.get_all(key) or [] for key in ("License-Expression", "License", "License-File", "Classifier")}
    stated = next((value for key in ("License-Expression", "License") for value in field[key]), "")
    if not stated or "\n" in stated or len(stated) > LONGEST:
        classes = [value.rpartition(" :: ")[2] for value in field["Classifier"] if value.startswith("License :: ")]
        stated = ", ".join(classes) or "".join(f"see its file {file}" for file in field["License-File"][:1]) or "not stated"
    return Licence(name, about["Version"], stated, note)
