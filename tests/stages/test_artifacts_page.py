"""docs/artifacts.md is the contract between stages: it names every array, attribute and info value that the stages write."""

import ast
import re
from pathlib import Path

import pytest
import torch
from e4dgs.scene.colour import CameraAffine
from e4dgs.scene.motion.nodes.control_nodes import ControlNodes
from e4dgs.scene.motion.nodes.rigid_parts import RigidParts
from e4dgs.scene.motion.planes.field import DeformationField

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "artifacts.md").read_text()
SECTIONS = {  # file of stages: heading on the page
    "frames/artifact": "## `frames`",
    "poses/artifact": "## `poses`",
    "depth/artifact": "## `depth`",
    "flow/artifact_writer": "## `flow`",
    "seeds/artifact": "## `seeds`",
    "coarse/artifact": "## `coarse`, `fine`",
    "shared/model": "## `coarse`, `fine`",
    "shared/training_log": "## `coarse`, `fine`",
    "hulls/artifact": "## `hulls`",
    "evaluate/artifact": "## `evaluate`",
}


def names_written(tree: ast.AST) -> set[str]:
    """Names that a file gives to arrays, attributes and info values, where it spells them in full."""
    constants = {
        node.targets[0].id: node.value.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name) and isinstance(node.value, ast.Constant)
    }
    found = set()
    for node in ast.walk(tree):
        match node:
            case ast.Call(func=ast.Attribute(attr="write" | "create") | ast.Name(id="create"), args=[ast.Constant(value=str(name)), *_]):
                found.add(name)
            case ast.Call(func=ast.Attribute(attr="create"), args=[ast.Name(id=of), *_]) if of in constants:
                found.add(constants[of])
            case ast.Call(func=ast.Attribute(value=ast.Attribute(attr="attrs"), attr="update"), keywords=values):
                found |= {one.arg for one in values if one.arg}
            case ast.Assign(
                targets=[ast.Subscript(value=ast.Attribute(attr="attrs" | "info"), slice=ast.Constant(value=str(name)))]
            ):  # fmt: skip
                found.add(name)
            case ast.ClassDef(name="Account", body=body):
                found |= {one.target.id for one in body if isinstance(one, ast.AnnAssign) and isinstance(one.target, ast.Name)}
    return found


def section(heading: str) -> str:
    start = PAGE.index(heading)
    end = PAGE.find("\n## ", start)
    return PAGE[start:end]


@pytest.mark.parametrize("file", SECTIONS)
def test_the_page_names_all_that_is_written(file):
    written = names_written(ast.parse((ROOT / "stages" / f"{file}.py").read_text()))
    assert written, "nothing was found to compare"
    assert {name for name in written if f"`{name}`" not in section(SECTIONS[file])} == set()


def test_every_file_that_writes_an_artifact_is_compared():
    files = [path for path in (ROOT / "stages").glob("*/*.py") if path.name.startswith("artifact") or path.parent.name == "shared"]
    writers = {path for path in files if names_written(ast.parse(path.read_text()))}
    assert {f"{path.parent.name}/{path.stem}" for path in writers} == SECTIONS.keys()


def test_names_are_found_in_every_form():
    lines = ["_A = 'a'", "out.create(_A, 1)", "out.write('b', 1)", "create('c', 1)", "out.attrs.update(d=1)", "out.info['e'] = 1"]
    lines += ["class Account:\n    f: int", "out.write(name, 1)", "print('g')"]
    assert names_written(ast.parse("\n".join(lines))) == set("abcdef")


@pytest.mark.parametrize("kind", ["planes", "nodes", "affine"])
def test_the_page_names_the_arrays_of_every_motion_and_of_the_colours_of_cameras(kind):
    box = torch.zeros(3), torch.ones(3)
    rigid = RigidParts(torch.zeros(1, 3), torch.ones(1), torch.ones(2, 1, 4), torch.zeros(2, 1, 3))
    made = {
        "planes": lambda: DeformationField(*box, 3),
        "nodes": lambda: ControlNodes(torch.rand(9, 3), box[0], 1.0, 1.0, rigid_parts=rigid),
        "affine": lambda: CameraAffine([0, 1]),
    }[kind]()
    prefix = "affine_" if kind == "affine" else "field_"
    text = section("## `coarse`, `fine`")
    for name in made.state_dict():
        level = re.sub(r"\.\d+$", ".l", prefix + name)  # planes of a level
        whole = (prefix + name, level, *(f"{prefix}{name[: end.start()]}.*" for end in re.finditer(r"\.", name)))
        assert any(f"`{form}`" in text for form in whole), f"{prefix}{name} is not on the page"
