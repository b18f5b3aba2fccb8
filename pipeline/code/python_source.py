"""The part of a Python file that can affect a result: no comments, docstrings or formatting, and nothing that only planning uses."""

from __future__ import annotations

import ast
from dataclasses import dataclass, field
from typing import Any

from ..files import digest_bytes

PLANNING = ("applies", "estimate", "resources")  # methods of a stage that are called for planning but not by the run
UNUSED = ("__all__", "__version__")  # module-level names whose values cannot affect a result
_UNTOLD = ("ctx", "kind", "type_comment", "type_ignores")  # fields of a syntax tree that follow from other fields, or are comments


@dataclass(frozen=True)
class PythonSource:
    """``digest``: of the code, "" if there is none. For a relative import it covers the names but not the module, so that a file may move.

    ``imports``: (dots, module, names) of each import anywhere in the file, in order; names is empty for ``import module``. Imports that
    only type checkers see are left out. ``names``: names bound at module level. ``later``: for a file whose ``__getattr__`` imports names
    on demand, the dict in which it looks them up (``{"Model": ".model"}``). Neither that dict nor ``__getattr__`` counts as code.
    """

    digest: str
    imports: list[tuple[int, str, list[str]]] = field(default_factory=list)
    names: list[str] = field(default_factory=list)
    later: dict[str, str] = field(default_factory=dict)


def read_python(data: bytes) -> PythonSource:
    """Returns the same for every version of Python that can parse the file. A file that cannot be parsed counts byte for byte."""
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
    """The statements of a file without `UNUSED` names and without the machinery for lazy imports, which is recorded in ``reader``."""
    lazy = [part for part in statements if isinstance(part, ast.FunctionDef) and part.name in ("__getattr__", "__dir__")]
    indices = [part for part in statements if isinstance(part, ast.Assign) and _index(part.value)] if lazy else []
    for part in indices:
        reader.later |= _index(part.value)
    unused = [part for part in statements if isinstance(part, ast.Assign) and _last_name(part.targets[0]) in UNUSED]
    if not indices:  # no lookup dict, so `__getattr__` is an ordinary function
        return [part for part in statements if part not in unused]
    reader.names += [part.name for part in lazy]
    return [part for part in statements if part not in (*lazy, *indices, *unused)]


def _index(node: ast.AST) -> dict[str, str]:
    """The entries of a dict literal that maps names to relative modules; {} for anything else."""
    if not isinstance(node, ast.Dict):
        return {}
    pairs = [(getattr(key, "value", None), getattr(value, "value", None)) for key, value in zip(node.keys, node.values)]
    found = {name: module for name, module in pairs if isinstance(name, str) and isinstance(module, str) and module.startswith(".")}
    return found if len(found) == len(pairs) else {}


class _Reader:
    """Writes out a syntax tree field by field. Empty fields are left out, because newer versions of Python add such fields."""

    def __init__(self) -> None:
        self.out: list[str] = []
        self.imports: list[tuple[int, str, list[str]]] = []
        self.names: list[str] = []
        self.later: dict[str, str] = {}
        self._inside = 0  # number of enclosing functions and classes

    def node(self, node: ast.AST) -> None:
        if isinstance(node, ast.Constant):
            self.out.append(f"{type(node.value).__name__} {node.value!a}")
        elif isinstance(node, ast.Pass) or (isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)):
            return  # a docstring, another constant that stands alone, or `pass`
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
                value = [part for part in value if getattr(part, "value", None) != ""]  # some Python versions add empty strings
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
