"""Sets up a training run in mid-course that can take single steps: views of a capture, Gaussians on its objects, a deformation field."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
import torch

from ....pipeline import Runner, SettingsError
from ....scene.model import Model
from ....scene.motion.phases import Phase
from ....scene.motion.planes.field import DeformationField
from ....scene.primitives import ConvexSet, GaussianSet
from ....scene.seeds.carve import carve
from ....scene.seeds.volume import common_volume
from ....scene.settings import TrainingSettings
from ....scene.training.trainer import Trainer
from ....scene.views import Views
from ...session import Options, open_session
from ..rows import Bench

COUNT = 30_000
SH_DEGREE = 2
SIZE = 400  # px; the sample's pictures are enlarged to this
SAMPLE = Path(__file__).resolve().parents[3] / "samples" / "cube_and_ball"
EARLIER = 9000  # steps that an earlier stage took: static parts no longer need all steps
STEPS, BEGUN = 1000, 400  # steps of the run, and steps already taken, when every term of the loss is active
PERIOD = 8  # steps in which every term of the loss occurs as often as on average


def views_of(bench: Bench) -> tuple[Views, list[np.ndarray] | None, str]:
    """Training views with decoded pictures, masks of their objects if there is alpha, and the capture's name."""
    from ....stages.shared.dataset import load_frameset, load_views

    path = bench.capture or SAMPLE
    if not path.exists():
        raise SettingsError(f"{path}: there is no such capture; give one with --capture")
    with TemporaryDirectory() as workspace:
        session = open_session(Options(path, Path(workspace)))
        outcomes = {o.stage: o.artifact for o in Runner(session.job).run(["poses"])}
        frames = load_frameset(outcomes, session.job.capture.root)
        views = load_views(frames, None)
        width, height = (SIZE, SIZE) if bench.capture is None else (views.width, views.height)
        width, height = bench.size(width, height)
        pictures = {int(i): cv2.resize(views.load(int(i)), (width, height)) for i in views.train}
        masks = None
        if frames.alpha:
            masks = [cv2.resize(frames.image(int(i))[..., 3], (width, height)) > 127 for i in views.train]
    K = views.K.copy()
    K[:, 0] *= width / views.width
    K[:, 1] *= height / views.height
    views = Views(
        K, views.cam_from_world, views.time, views.camera, views.next, views.train, width, height, pictures.__getitem__, views.background
    )
    return views, masks, session.job.capture.name


def make_model(bench: Bench, views: Views, masks: list[np.ndarray] | None, count: int = COUNT) -> Model:
    """A model: Gaussians scattered over the capture's objects, half of them nearly opaque, all dynamic, and a field that is not zero."""
    count = bench.count(count, 200)
    settings = TrainingSettings.model_validate({})
    if masks is not None:
        chosen = np.arange(len(views.train))[:: max(1, len(views.train) // 40)]
        points, colors = carve(views, [masks[k] for k in chosen], views.train[chosen], count, settings.seed)
    else:
        centre, radius = common_volume(views)
        rng = np.random.default_rng(settings.seed)
        points, colors = centre + rng.uniform(-0.5, 0.5, (count, 3)) * radius, rng.uniform(0, 1, (count, 3))
    gaussians = GaussianSet.from_points(points, colors, SH_DEGREE)
    low, high = points.min(0), points.max(0)
    margin = 0.2 * (high - low).max()
    field = DeformationField(torch.tensor(low - margin), torch.tensor(high + margin), len(np.unique(views.time)))
    generator = torch.Generator().manual_seed(1)
    with torch.no_grad():
        gaussians.opacity_logits.copy_(1.5 * torch.randn(count, generator=generator))
        field.head.weight.copy_(0.003 * torch.randn(field.head.weight.shape, generator=generator))
    return Model(gaussians, ConvexSet.empty(6, SH_DEGREE), field, SH_DEGREE)


def make_trainer(model: Model, views: Views) -> tuple[Trainer, Callable[[], None]]:
    """A trainer in mid-course, and a function that takes `PERIOD` whole steps, without density control and checkpoints in between."""
    phase, settings = Phase("deformation", STEPS), TrainingSettings.model_validate({})
    trainer = Trainer(model, views, [phase], settings, budget=len(model.gaussians), grow=False, earlier=EARLIER)
    trainer.iteration = BEGUN

    def period() -> None:
        for _ in range(PERIOD):
            trainer._step(phase, trainer.iteration)
            trainer.iteration += 1

    return trainer, period
