"""Masks whose black pixels count for nothing: found in each layout, bent as their pictures are, and honoured from features to metrics."""

import json
import shutil

import numpy as np
import pytest
import torch
from e4dgs.pipeline import CaptureError
from e4dgs.scene.model import Model
from e4dgs.scene.motion.static import Static
from e4dgs.scene.primitives import ConvexSet, GaussianSet
from e4dgs.scene.views import WHOLLY, floats
from e4dgs.stages.captures import recognise
from e4dgs.stages.evaluate.judge import Judge
from e4dgs.stages.shared.dataset import load_views
from e4dgs.stages.shared.frameset import FrameSet
from e4dgs.stages.shared.masks import moving_mask, unsteady_mask
from factory import Options, make, write_images
from PIL import Image
from run_stage import run_frames, run_poses
from write_artifact import write_artifact

BLACK = (slice(10, 40), slice(0, 30))  # rows, columns


def write_mask(file, size=(80, 64), black=BLACK):
    mask = np.full(size[::-1], 255, np.uint8)
    mask[black] = 0
    file.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(mask).save(file)


@pytest.fixture
def masked(nerfstudio_capture, tmp_path):
    """A nerfstudio capture with `mask_path` on every frame but the last."""
    root = shutil.copytree(nerfstudio_capture.root, tmp_path / "masked")
    data = json.loads((root / "transforms.json").read_text())
    for i, frame in enumerate(data["frames"][:-1]):
        frame["mask_path"] = f"masks/{i:03d}.png"
        write_mask(root / frame["mask_path"])
    (root / "transforms.json").write_text(json.dumps(data))
    return root


def test_nerfstudio_masks_say_what_counts_and_not_what_moves(masked, tmp_path):
    capture = recognise(masked)
    assert capture.masks is None and capture.keeps[0] == "masks/000.png" and capture.keeps[-1] is None
    assert "masks/000.png" in capture.files
    assert any("9 of 10 images have a mask (mask_path)" in note and "left out of training" in note for note in capture.notes)
    ran = run_frames(masked, tmp_path)
    frames = FrameSet(ran.artifact, masked)
    assert frames.mask(0) is None and frames.kept(9) is None
    kept = frames.kept(0)
    assert kept.shape == (64, 80) and kept.dtype == bool
    assert not kept[15:35, 3:25].any() and kept[45:].all() and kept[:, 40:].all(), "bent by a few pixels with the picture"


@pytest.mark.parametrize("flat", [True, False])
def test_the_share_that_masks_leave_out_is_told(images_capture, tmp_path, flat):
    """Where it is most of the area, white may mark what moves: the command inverts the masks, and no picture."""
    root = shutil.copytree(images_capture.root, tmp_path / "my scene")
    pictures = sorted(root.glob("*.png"))
    for black, share in ((BLACK, "12%"), ((slice(None), slice(0, 72)), "75%")):
        for picture in pictures:
            write_mask(root / (f"{picture.stem}_mask.png" if flat else f"masks/{picture.name}"), size=(96, 80), black=black)
        (note,) = [note for note in recognise(root).notes if "have a mask" in note]
        assert f"left out of training and metrics: {share} of the area (judged by 8 masks)" in note
        own = f"'{root}'/*mask.png" if flat else f"'{root / 'masks'}'/*.png"
        assert note.endswith(f"invert the masks: magick mogrify -negate {own}") == (share == "75%"), note


@pytest.mark.parametrize("name", ["003.png.png", "003.png", "003.jpg"])
def test_masks_beside_images(colmap_capture, tmp_path, name):
    root = shutil.copytree(colmap_capture.root, tmp_path / "capture")
    write_mask(root / "masks" / name)
    capture = recognise(root)
    assert [bool(keep) for keep in capture.keeps] == [False] * 3 + [True] + [False] * 4 and capture.keeps[3] == f"masks/{name}"
    assert any("1 of 8 images have a mask in masks/" in note for note in capture.notes)
    (root / "masks" / name).rename(root / "masks/other.png")
    capture = recognise(root)
    assert capture.keeps is None and any("masks/ has no mask of any image" in note for note in capture.notes)


def test_what_is_said_of_masks_that_cannot_be(masked, tmp_path):
    write_mask(masked / "masks/004.png", (40, 32))
    with pytest.raises(CaptureError, match=r"masks/004\.png: the mask is 40x32, its image 80x64; make them one size"):
        recognise(masked)
    write_mask(masked / "masks/004.png", black=np.s_[:, :])
    with pytest.raises(CaptureError, match=r"masks/004\.png: the mask is black everywhere.*invert the masks"):
        run_frames(masked, tmp_path / "black")
    (masked / "masks/004.png").write_bytes((masked / "masks/005.png").read_bytes()[:60])
    with pytest.raises(CaptureError, match=r"masks/004\.png: the mask cannot be decoded"):
        run_frames(masked, tmp_path / "cut")
    (masked / "masks/004.png").unlink()
    with pytest.raises(CaptureError, match=r"frame 4: mask_path: no image 'masks/004\.png'"):
        recognise(masked)


def test_features_are_found_where_masks_are_white(tmp_path):
    """Something that stands before the lens and hides a third of each picture: with its features there would be two motions to explain."""
    import pycolmap

    options = Options(backdrop="room", rig="path", times=7, width=240, height=180, samples=2, fov_degrees=60.0, motion=0.0)
    capture = write_images(make(options), tmp_path / "room/images")
    hidden = np.s_[:, :80]
    noise = np.random.default_rng(0).integers(0, 256, (180, 80, 3), np.uint8)
    for name in capture.files:
        picture = np.asarray(Image.open(capture.root / name)).copy()
        picture[hidden] = noise
        Image.fromarray(picture).save(capture.root / name)
        write_mask(tmp_path / "room/masks" / name, (240, 180), hidden)
    ran = run_poses(tmp_path / "room", tmp_path / "out", moving=False)
    assert ran.artifact.read("registered").all()
    with pycolmap.Database.open(tmp_path / "out/checkpoints/poses/colmap/database.db") as database:
        x = np.concatenate([database.read_keypoints(image.image_id)[:, 0] for image in database.read_all_images()])
    assert len(x) > 500 and x.min() > 78


def frameset(root, folder):
    return FrameSet(run_frames(root, folder).artifact, root)


def spoiled(root, target):
    """The same capture, other pictures under the black pixels (and a margin within them that undistortion smears over their border)."""
    shutil.copytree(root, target)
    for file in sorted((target / "images").iterdir())[:-1]:
        picture = np.asarray(Image.open(file)).copy()
        inside = picture[BLACK][3:-3, :-3]
        picture[13:37, 0:27] = 255 - inside
        Image.fromarray(picture).save(file)
    return target


def test_metrics_see_only_what_counts(masked, tmp_path):
    rng = np.random.default_rng(0)
    gaussians = GaussianSet.from_points(rng.uniform(-1, 1, (40, 3)), rng.random((40, 3)), 0)
    model = Model(gaussians, ConvexSet.empty(6, 0), Static(), 0)
    clean, other = frameset(masked, tmp_path / "a"), frameset(spoiled(masked, tmp_path / "spoiled"), tmp_path / "b")
    judges = [Judge(model, frames, None, False) for frames in (clean, other)]
    before, after = (judge.measured(0, *judge.render(0)) for judge in judges)
    assert not np.array_equal(clean.image(0), other.image(0))
    assert before["psnr"] == pytest.approx(after["psnr"], abs=1e-9) and before["psnr_affine"] == pytest.approx(
        after["psnr_affine"], abs=1e-9
    )
    assert before["ssim"] == pytest.approx(after["ssim"], abs=0.01)
    unmasked = [judge.measured(9, *judge.render(9))["psnr"] for judge in judges]
    assert unmasked[0] == unmasked[1], "the last frame has no mask and was not changed"


def test_training_sees_only_what_counts(masked, tmp_path):
    """The same steps on pictures that differ under the masks end in the same model."""
    from e4dgs.scene.motion.phases import coarse_phases
    from e4dgs.scene.settings import TrainingSettings
    from e4dgs.scene.training.trainer import Trainer

    def trained(root, folder, keep=True):
        frames = frameset(root, folder)
        views = load_views(frames, None)
        if not keep:
            views.load_kept = None
        rng = np.random.default_rng(0)
        gaussians = GaussianSet.from_points(rng.uniform(-2, 2, (80, 3)), np.full((80, 3), 0.5), 0, max_scale=0.3)
        model = Model(gaussians, ConvexSet.empty(6, 0), Static(), 0)
        torch.manual_seed(0)
        settings = TrainingSettings(iterations=300, sh_degree=0, densify_every=50)
        log = Trainer(model, views, coarse_phases("two-stage", 300, True), settings, 200).run()
        assert max(count for _, count, _ in log.primitives) > 90, "Gaussians are added where the error is"
        return model.to_arrays()

    other = spoiled(masked, tmp_path / "spoiled")
    first, second = trained(masked, tmp_path / "a"), trained(other, tmp_path / "b")
    for name in first:
        np.testing.assert_array_equal(first[name], second[name], err_msg=name)
    careless = trained(other, tmp_path / "c", keep=False)
    assert len(careless["gaussians_means"]) != len(first["gaussians_means"]) or not np.allclose(
        careless["gaussians_means"], first["gaussians_means"]
    )


def test_views_shrink_what_counts_to_whole_pixels(masked, tmp_path):
    views = load_views(frameset(masked, tmp_path), None)
    whole, half = views.kept(0), views.kept(0, 0.5)
    assert whole.dtype == torch.bool and half.shape == (32, 40)
    blocks = whole.reshape(32, 2, 40, 2).all(3).all(1)
    assert torch.equal(half, blocks)
    assert views.kept(9).all()
    assert torch.equal(floats(views.stored(0, 1.0, "kept", (5, 6, 30, 50))) >= WHOLLY, whole[6:50, 5:30])


def test_what_does_not_count_neither_moves_nor_stands_still(masked, tmp_path):
    from types import SimpleNamespace

    frames = frameset(masked, tmp_path)
    moving = np.zeros((10, 64, 80), np.uint8)
    moving[:, 20:50, 10:60] = 255

    kept, moves = frames.kept(0), moving[0] > 0
    with_flow, without = (SimpleNamespace(inputs={"flow": flow}) for flow in (write_artifact(tmp_path / "flow", {"moving": moving}), None))
    np.testing.assert_array_equal(moving_mask(with_flow, frames, 0), moves & kept)
    np.testing.assert_array_equal(unsteady_mask(with_flow, frames, 0), moves | ~kept)
    np.testing.assert_array_equal(unsteady_mask(without, frames, 0), ~kept)
    assert moving_mask(without, frames, 0) is None and unsteady_mask(without, frames, 9) is None
