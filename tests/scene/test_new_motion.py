"""A motion that the program does not have: one folder, and one row of the table of kinds. `docs/extending.md` shows this one."""

from pathlib import Path as File

import numpy as np
import pytest
import torch
from e4dgs.rasterizer import Camera
from e4dgs.scene.model import Model
from e4dgs.scene.motion.kinds import KINDS, MotionKind, motion_class
from e4dgs.scene.motion.start import Start
from e4dgs.scene.primitives import ConvexSet, GaussianSet
from e4dgs.scene.training.checkpoint import model_of
from e4dgs.scene.training.trainer import Trainer
from sliding_gaussians import SETTINGS, make_views
from swinging.swing import Swing

STEPS = 60
PAGE = File(__file__).resolve().parents[2] / "docs" / "extending.md"


@pytest.fixture(autouse=True)
def row(monkeypatch):
    monkeypatch.setitem(KINDS, "swing", MotionKind("Gaussians that swing to and fro", lambda: Swing))


def swinging(views):
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.5, 0.5, (30, 3))
    start = Start(points, np.full((30, 3), 0.5), np.arange(30) % 3 > 0, None, 0, 0.2)
    motion, gaussians = motion_class("swing").start(start, views, SETTINGS)
    corners = rng.uniform(-0.3, 0.3, (2, 6, 3))
    return Model(gaussians, ConvexSet.from_points(corners, np.full((2, 3), 0.5), 0), motion, 0)


def test_it_trains_and_goes_on_from_its_checkpoint(tmp_path):
    views = make_views(cameras=3, times=4, size=24)
    model = swinging(views)
    assert [name for name in model.gaussians.parameters if name not in GaussianSet.FIELDS] == ["arm"]
    assert len(model.convexes.arm) == 2
    before = {name: p.detach().clone() for name, p in model.named_parameters().items()}
    phases = model.motion.phases("two-stage", STEPS, 0.5, small=True)
    settings = SETTINGS.model_copy(update={"iterations": STEPS, "checkpoint_seconds": 1e-9})
    trainer = Trainer(model, views, phases, settings, budget=60, checkpoints=tmp_path)
    trainer.run()
    assert trainer.log.iterations == STEPS and trainer.log.nonfinite_steps == 0
    after = model.named_parameters()
    assert all(not torch.equal(after[name], before[name]) for name in ("motion.rhythm", "gaussians.arm", "convexes.arm"))
    kept, step = model_of(tmp_path)
    assert step == STEPS and kept.motion.kind == "swing" and kept.gaussians.arm.any()
    again = Trainer(swinging(views), views, phases, settings, budget=60, checkpoints=tmp_path)
    assert again.run().iterations == STEPS
    assert torch.equal(again.model.gaussians.arm, model.gaussians.arm) and torch.equal(again.model.motion.rhythm, model.motion.rhythm)


def test_it_is_saved_and_rendered():
    model = swinging(make_views(cameras=2, times=3, size=24))
    with torch.no_grad():
        model.gaussians.arm.normal_(0, 0.3, generator=torch.Generator().manual_seed(0))
    arrays = model.to_arrays()
    assert "gaussians_arm" in arrays and "gaussians_hyper" not in arrays
    again = Model.from_arrays(arrays, model.config)
    pose = torch.eye(4)
    pose[2, 3] = 3.0
    camera = Camera(torch.tensor([[30.0, 0, 16], [0, 30.0, 16], [0, 0, 1]]), pose, 32, 32)
    now, later = (again.render(camera, t).color for t in (0.0, 0.25))
    assert torch.equal(now, model.render(camera, 0.0).color) and not torch.equal(now, later)
    # Without its array, each primitive is at rest.
    assert not Model.from_arrays({k: v for k, v in arrays.items() if not k.endswith("_arm")}, model.config).gaussians.arm.any()


def test_the_page_shows_it():
    source = (File(__file__).resolve().parents[1] / "swinging" / "swing.py").read_text()
    assert source[source.index("import math") :] in PAGE.read_text()
