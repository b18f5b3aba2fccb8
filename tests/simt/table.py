"""The kernels of a source, found in its preprocessed text by the attributes that `simt.h` makes of CUDA's words."""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

from .error import SimtError

KERNEL = re.compile(r"__attribute__\(\(simt_kernel\b")
BOUND = re.compile(r"__attribute__\(\(simt_bound(?=\()")
NAME = re.compile(r"\bvoid\b.*?\b(\w+)\s*(?=\()", re.DOTALL)


class Signature(NamedTuple):
    name: str
    parameters: list[str]  # names
    bound: str  # of threads a block, an expression


def table(text: str, source: Path) -> str:
    """C++ to stand below the preprocessed text of a source: the table that runtime.h declares."""
    kernels = [signature(text, found.start()) for found in KERNEL.finditer(text)]
    if not kernels:
        raise SimtError(f"{source} has no kernel with these macros")
    lines = ["", '# 1 "table of kernels"', "namespace { namespace e4dgs {} using namespace e4dgs;"]
    for kernel in kernels:
        names = ", ".join(f'"{name}"' for name in kernel.parameters)
        lines.append(f"constexpr auto simt_parameters_of_{kernel.name} = simt::Entry<&{kernel.name}>::named({names});")
        lines.append(f"constexpr int simt_bound_of_{kernel.name} = {kernel.bound};")
    lines.append("const simt::Kernel simt_table[] = {")
    for name, parameters, _ in kernels:
        lines.append(f'{{"{name}", simt::Entry<&{name}>::call, simt_parameters_of_{name}.at, {len(parameters)}, simt_bound_of_{name}}},')
    lines.append(
        f"}}; }}\nnamespace simt {{ extern const Kernel* const kernels = simt_table; extern const int n_kernels = {len(kernels)}; }}"
    )
    return "\n".join(lines) + "\n"


def signature(text: str, start: int) -> Signature:
    """The kernel whose declaration starts here."""
    declaration = re.sub(r"^#.*$", "", text[start : text.index("{", start)], flags=re.MULTILINE)
    bound = "1024"
    if found := BOUND.search(declaration):
        bound = bracketed(declaration, found.end())
        declaration = declaration[: found.start()] + declaration[found.end() + len(bound) + len("()))") :]
    found = NAME.search(declaration)
    if not found:
        raise SimtError(f"this is no kernel with a plain name: {declaration.strip()}")
    words = [re.findall(r"\w+", parameter) for parameter in bracketed(declaration, found.end()).split(",")]
    return Signature(found[1], [parameter[-1] for parameter in words if parameter and parameter != ["void"]], bound)


def bracketed(text: str, start: int) -> str:
    """What stands in the brackets that open at `start`."""
    depth = 0
    for at in range(start, len(text)):
        depth += {"(": 1, ")": -1}.get(text[at], 0)
        if depth == 0:
            return text[start + 1 : at]
    raise SimtError(f"brackets do not close: {text[start : start + 200]}")
