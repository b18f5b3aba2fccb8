"""What a model knows of the capture that it was trained on: near plane, background, how its cameras record colours."""

import numpy as np
import pytest
import torch
from e4dgs.rasterizer import Camera
from e4dgs.scene.colour import CameraAffine, colour_recorders
from e4dgs.scene.model import Model
from e4dgs.scene.motion.phases import Phase
from e4dgs.scene.motion.static import Static
from e4dgs.scene.primitives import ConvexSet, GaussianSet
from e4dgs.scene.settings import TrainingSettings
from e4dgs.scene.training.control.density import measure_responsibility
from e4dgs.scene.training.trainer import Trainer
from e4dgs.scene.views import Views

SIZE = 24
GAIN = {3: 1.25, 8: 0.8}


def model(**known) -> Model:
    """A dark blob that covers the picture at depth 4, a bright speck at depth 1 before it."""
    gaussians = GaussianSet.from_points(np.array([[0.0, 0, 4], [0, 0, 1]]), np.array([[0.4] * 3, [1.0] * 3]), 0, opacity=0.95)
    with torch.no_grad():
        gaussians.log_scales[:] = torch.tensor([[1.5], [-2.5]])
    return Model(gaussians, ConvexSet.empty(6, 0), Static(), 0, **known)


def camera(width=SIZE) -> Camera:
    return Camera(torch.tensor([[20.0, 0, 12], [0, 20, 12], [0, 0, 1]]), torch.eye(4), width, SIZE)


def views(times=3) -> Views:
    """Two cameras of numbers 3 and 8 in one place, which record the blob with gains of 1.25 and 0.8."""
    truth = model(near=2.0).render(camera(), 0.0).color.numpy()
    number = np.repeat(sorted(GAIN), times)
    count, poses = len(number), np.tile(np.eye(4), (len(number), 1, 1))
    return Views(
        np.tile(camera().K.double().numpy(), (count, 1, 1)), poses, np.tile(np.linspace(0, 1, times), 2), number, np.full(count, -1),
        np.arange(count), SIZE, SIZE, lambda i: np.rint(255 * GAIN[int(number[i])] * truth).astype(np.uint8), near=2.0,
    )  # fmt: skip


def test_what_is_nearer_than_the_near_plane_is_not_drawn():
    whole, cut = (model(near=near).render(camera(), 0.0).color[12, 12, 0].item() for near in (0.01, 2.0))
    assert whole > 0.8 and cut == pytest.approx(0.4, abs=0.05)


def test_the_background_is_the_models_own_unless_another_is_given():
    with torch.no_grad():
        (empty := model(background=(0.25, 0.5, 0.75))).gaussians.opacity_logits[:] = -9
    assert torch.allclose(empty.render(camera(), 0.0).color[0, 0], torch.tensor([0.25, 0.5, 0.75]))
    assert torch.allclose(empty.render(camera(), 0.0, torch.ones(3)).color[0, 0], torch.ones(3))


def test_all_of_it_is_saved_and_read():
    affine = CameraAffine([3, 8])
    with torch.no_grad():
        affine.log_gain[0] = 0.3
        affine.offset[1] = -0.1
    written = model(near=0.7, background=(0.1, 0.2, 0.3), affine=affine)
    read = Model.from_arrays(written.to_arrays(), written.config)
    assert (read.near, read.background, read.affine.cameras) == (0.7, (0.1, 0.2, 0.3), [3, 8])
    image = torch.rand(4, 5, 3)
    assert torch.equal(read.affine(image, 8), affine(image, 8)) and not torch.equal(affine(image, 8), image)
    assert torch.equal(read.affine(image, 99), image), "a camera that was not trained on is the mean camera"
    assert Model.from_arrays(model().to_arrays(), model().config).affine is None


def test_gains_are_learned_and_a_later_stage_goes_on_with_them():
    seen, blob = views(), model(near=2.0)
    settings = TrainingSettings(iterations=150, sh_degree=0, ssim_weight=0.0, opacity_weight=0.0, min_contribution=0.0)
    phases = [Phase("rest", 150, move=False)]
    Trainer(blob, seen, phases, settings, budget=2, grow=False).run()

    def ratio() -> float:
        gain = torch.exp(blob.affine.log_gain.detach().mean(1))
        return float(gain[0] / gain[1])

    first = ratio()
    assert first > 1.05
    Trainer(blob, seen, [Phase("rest", 1, move=False)], settings, budget=2, grow=False).run()
    assert ratio() == pytest.approx(first, abs=0.01), "not begun anew"
    Trainer(blob, seen, phases, settings, budget=2, grow=False).run()
    assert first + 0.02 < ratio() < 1.02 * GAIN[3] / GAIN[8]


def test_photos_of_one_camera_have_an_exposure_each():
    """Six pictures of one camera, every other one darker: told to be photos, each has a row; told to be a video, they have none."""
    seen, blob = views(), model(near=2.0)
    bright = seen.camera == 3
    seen.camera = np.zeros(6, int)
    assert colour_recorders(seen) is None
    seen.recorder = np.arange(6)
    settings = TrainingSettings(iterations=150, sh_degree=0, ssim_weight=0.0, opacity_weight=0.0)
    Trainer(blob, seen, [Phase("rest", 150, move=False)], settings, budget=2, grow=False).run()
    gain = torch.exp(blob.affine.log_gain.detach().mean(1)).numpy()
    assert blob.affine.cameras == list(range(6)) and gain[bright].min() > 1.05 * gain[~bright].max()


def test_rendered_captures_whose_frames_are_cameras_of_their_own_have_one_exposure():
    seen = views()
    seen.camera = np.arange(6)
    assert colour_recorders(seen) is None


def test_what_gains_explain_is_no_error_to_grow_at():
    seen, blob = views(), model(near=2.0)
    frames = [int(i) for i in seen.train]
    wrong = measure_responsibility(blob, seen, frames, move=False).error_gaussians.sum()
    blob.affine = CameraAffine(GAIN)
    with torch.no_grad():
        blob.affine.log_gain[:] = torch.log(torch.tensor([list(GAIN.values())])).T
    assert float(measure_responsibility(blob, seen, frames, move=False).error_gaussians.sum()) < 0.1 * float(wrong)


def test_growth_reaches_the_budget_on_images_of_full_size():
    """Small images of half the size take at most a part of it."""
    rng = np.random.default_rng(0)
    picture = rng.integers(0, 255, (SIZE, SIZE, 3), np.uint8)
    seen = views()
    seen.load = lambda i: picture
    points = rng.uniform([-1, -1, 3], [1, 1, 5], (60, 3))
    blob = Model(GaussianSet.from_points(points, np.full((60, 3), 0.5), 0, opacity=0.6), ConvexSet.empty(6, 0), Static(), 0)
    settings = TrainingSettings(iterations=400, sh_degree=0, densify_every=25, densify_until=0.9, min_contribution=0.0, min_opacity=0.0)
    trainer = Trainer(blob, seen, [Phase("half", 300, False, 0.5), Phase("full", 100, False)], settings, budget=200)
    log = trainer.run()
    assert max(n for step, n, _ in log.primitives if step <= 300) <= 120 < max(n for _, n, _ in log.primitives) <= 200
