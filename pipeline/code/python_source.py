"""What of a Python file can decide a result: no comments, docstrings or formatting, and nothing that only a plan asks for."""

from __future__ import annotations

import ast
from dataclasses import dataclass, field
from typing import Any

from ..files import digest_bytes

PLANNING = ("applies", "estimate", "resources")  # methods of stages that a plan asks, and a run does not
UNUSED = ("__all__", "__version__")  # names at the top of a file whose values decide nothing
_UNTOLD = ("ctx", "kind", "type_comment", "type_ignores")  # fields of a tree that follow from others, or are comments


@dataclass(frozen=True)
class PythonSource:
    """``digest``: of the code, "" where there is none. Of relative imports it holds the names and not the places, so that a file may move.

    ``imports``: (dots, module, names) of each import anywhere in the file, in order; no names for ``import module``. Imports for type
    checkers alone are left out. ``names``: what is bound at the top of the file. ``later``: of a file whose ``__getattr__`` finds
    names when they are asked for, what it looks them up in (``{"Model": ".model"}``); neither counts as code.
    """

    digest: str
    imports: list[tuple[int, str, list[str]]] = field(default_factory=list)
    names: list[str] = field(default_factory=list)
    later: dict[str, str] = field(default_factory=dict)


def read_python(data: bytes) -> PythonSource:
    """The same for all versions of Python that can parse the file. What cannot be parsed counts byte for byte."""
    try:
        tree = ast.parse(data)
    except (SyntaxError, ValueError):
        return PythonSource(digest_bytes(data))
    reader = _Reader()
    for statement in _without_index(tree.body, reader):
        reader.node(statement)
    text = "\n".join(reader.out)
    return PythonSource(digest_bytes(text.encode()) if text else "", reader.imports, reader.names, reader.later)


def _without_index(statements: list[ast.stmt], reader: _Reader) -> list[ast.stmt]:
    """Statements of a file without `UNUSED` names, and without what only finds names later, of which the reader is told."""
    lazy = [part for part in statements if isinstance(part, ast.FunctionDef) and part.name in ("__getattr__", "__dir__")]
    indices = [part for part in statements if isinstance(part, ast.Assign) and _index(part.value)] if lazy else []
    for part in indices:
        reader.later |= _index(part.value)
    unused = [part for part in statements if isinstance(part, ast.Assign) and _last_name(part.targets[0]) in UNUSED]
    if not indices:  # `__getattr__` is a function like others
        return [part for part in statements if part not in unused]
    reader.names += [part.name for part in lazy]
    return [part for part in statements if part not in (*lazy, *indices, *unused)]


def _index(node: ast.AST) -> dict[str, str]:
    """Names and the modules that they are found in, where this is a dict of such."""
    if not isinstance(node, ast.Dict):
        return {}
    pairs = [(getattr(key, "value", None), getattr(value, "value", None)) for key, value in zip(node.keys, node.values)]
    found = {name: module for name, module in pairs if isinstance(name, str) and isinstance(module, str) and module.startswith(".")}
    return found if len(found) == len(pairs) else {}


class _Reader:
    """Writes a tree down, field by field. Fields that are empty are left out, since later versions of Python add such."""

    def __init__(self) -> None:
        self.out: list[str] = []
        self.imports: list[tuple[int, str, list[str]]] = []
        self.names: list[str] = []
        self.later: dict[str, str] = {}
        self._inside = 0  # functions and classes around

    def node(self, node: ast.AST) -> None:
        if isinstance(node, ast.Constant):
            self.out.append(f"{type(node.value).__name__} {node.value!a}")
        elif isinstance(node, ast.Pass) or (isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)):
            return  # a docstring, or nothing at all
        elif isinstance(node, ast.If) and _last_name(node.test) == "TYPE_CHECKING":
            self._value(node.orelse)
        elif isinstance(node, (ast.Import, ast.ImportFrom)):
            self._import(node)
        elif isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
            self._definition(node)
        else:
            if not self._inside and isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
                self.names.append(node.id)
            self._fields(node)

    def _fields(self, node: ast.AST) -> None:
        self.out.append(f"({type(node).__name__}")
        for name in node._fields:
            value = getattr(node, name, None)
            if name in _UNTOLD or value is None or value == []:
                continue
            if name == "keywords" and isinstance(node, ast.Call) and _last_name(node.func) == "Field":
                value = [keyword for keyword in value if keyword.arg != "description"]  # the docstring of a setting
            if isinstance(node, ast.JoinedStr):
                value = [part for part in value if getattr(part, "value", None) != ""]  # some versions of Python put such there
            self.out.append(name)
            self._value(value)
        self.out.append(")")

    def _value(self, value: Any) -> None:
        if isinstance(value, ast.AST):
            self.node(value)
        elif isinstance(value, list):
            for item in value:
                self._value(item)
        else:
            self.out.append(ascii(value))

    def _import(self, node: ast.Import | ast.ImportFrom) -> None:
        relative = isinstance(node, ast.ImportFrom) and node.level > 0
        if relative:
            self.out += ["import", *(f"{alias.name} {alias.asname}" for alias in node.names)]
        else:
            self._fields(node)
        if isinstance(node, ast.ImportFrom):
            self.imports.append((node.level, node.module or "", [alias.name for alias in node.names]))
        else:
            self.imports += [(0, alias.name, []) for alias in node.names]
        if not self._inside:
            self.names += [alias.asname or alias.name.partition(".")[0] for alias in node.names]

    def _definition(self, node: ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef) -> None:
        if not self._inside:
            self.names.append(node.name)
        if isinstance(node, ast.ClassDef) and "Stage" in map(_last_name, node.bases):
            node.body = [part for part in node.body if not (isinstance(part, ast.FunctionDef) and part.name in PLANNING)]
        self._inside += 1
        self._fields(node)
        self._inside -= 1


def _last_name(node: ast.AST) -> str:
    return node.attr if isinstance(node, ast.Attribute) else node.id if isinstance(node, ast.Name) else ""
