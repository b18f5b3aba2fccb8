"""docs/artifacts.md lists the arrays of a model: every one that is saved, with its shape and dtype, and no other."""

import re
from pathlib import Path

import numpy as np
import torch
from e4dgs.scene.model import Model
from e4dgs.scene.motion.lifetimes.lifetimes import Lifetimes
from e4dgs.scene.motion.nodes.control_nodes import ControlNodes
from e4dgs.scene.motion.static import Static
from e4dgs.scene.primitives import ConvexSet, GaussianSet

PAGE = Path(__file__).resolve().parents[2] / "docs" / "artifacts.md"
ROW = re.compile(r"^\| `((?:gaussians|convexes)_\w+)` \| \[([\w,]+)\] \| ([^|]*)\|", re.MULTILINE)
ALIKE = re.compile(r"^\| (`convexes_\w+`(?:, `convexes_\w+`)+) \| as for Gaussians, M rows", re.MULTILINE)
SIZES = {"N": 7, "M": 5, "K": 6, "R": 8}


def model(motion=Static):
    rng = np.random.default_rng(0)
    gaussians = GaussianSet.from_points(rng.uniform(-1, 1, (SIZES["N"], 3)), rng.random((SIZES["N"], 3)), 2)
    convexes = ConvexSet.from_points(rng.uniform(-1, 1, (SIZES["M"], SIZES["K"], 3)), rng.random((SIZES["M"], 3)), 2)
    return Model(gaussians, convexes, motion(), 2)


def models():
    """One with each motion that has attributes of its own, and one without."""
    nodes = ControlNodes(torch.zeros(1, 3), torch.zeros(3), 1.0, 1.0)
    return {"static": model(), "lifetimes": model(lambda: Lifetimes(9)), "nodes": model(lambda: nodes)}


def test_every_array_of_a_model_is_on_the_page():
    arrays = {name: array for one in models().values() for name, array in one.to_arrays().items() if not name.startswith("field_")}
    listed = {name: tuple(SIZES.get(n) or int(n) for n in shape.split(",")) for name, shape, _ in ROW.findall(PAGE.read_text())}
    (alike,) = ALIKE.findall(PAGE.read_text())
    for name in re.findall(r"\w+", alike):
        listed[name] = (SIZES["M"], *listed[name.replace("convexes", "gaussians")][1:])
    assert listed == {name: array.shape for name, array in arrays.items()}
    assert all(array.dtype == (bool if name.endswith("_dynamic") else np.float32) for name, array in arrays.items())


def test_a_model_has_only_the_arrays_that_its_motion_needs():
    extra = {motion: {name.partition("_")[2] for name in one.to_arrays()} for motion, one in models().items()}
    names = {"hyper", "shades", "times", "log_spans", "velocities", "spins"}
    assert extra["static"] & names == set() and extra["nodes"] & names == {"hyper", "shades"}
    assert extra["lifetimes"] & names == {"times", "log_spans", "velocities", "spins"}


def test_units_follow_the_names():
    units = {name: unit.strip() for name, _, unit in ROW.findall(PAGE.read_text())}
    for name, unit in units.items():
        assert unit.startswith("ln(") == ("_log_" in name) and (unit == "logit") == name.endswith("_logits"), name


def test_what_the_page_says_of_opacity_and_colour_is_so():
    one = model()
    arrays = one.to_arrays()
    np.testing.assert_allclose(1 / (1 + np.exp(-arrays["gaussians_opacity_logits"])), one.gaussians.opacities.detach(), rtol=1e-6)
    rng = np.random.default_rng(0)
    rng.uniform(-1, 1, (SIZES["N"], 3))
    np.testing.assert_allclose(0.5 + 0.28209479 * arrays["gaussians_sh_dc"][:, 0], rng.random((SIZES["N"], 3)), atol=1e-6)
