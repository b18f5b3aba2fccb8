"""What a reconstruction says is sane: poisoned points go, adjustments that worsen are undone, parts add up, left-out frames come back."""

from pathlib import Path

import numpy as np
import pytest
from e4dgs.vision.sfm.alignment import camera_centres, robust_similarity
from e4dgs.vision.sfm.plausible import plausible
from e4dgs.vision.sfm.worker.lens import lens_trouble

pycolmap = pytest.importorskip("pycolmap")
from e4dgs.vision.sfm.impossible_points import observe, purge  # noqa: E402
from e4dgs.vision.sfm.worker import reclaim as module  # noqa: E402
from e4dgs.vision.sfm.worker.reclaim import reclaim  # noqa: E402
from e4dgs.vision.sfm.worker.reconstruct import parts  # noqa: E402
from e4dgs.vision.sfm.worker.refine import refine, refine_or_keep  # noqa: E402
from e4dgs.vision.sfm.worker.result import result_arrays  # noqa: E402

NOISE = 0.2  # px


def synthesize(images: int = 8, points: int = 150, database: Path | None = None):
    """A model with exact cameras and features with noise; its matches go to the database."""
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_cameras_per_rig, options.num_frames_per_rig, options.num_points3D = 1, 1, images, points
    pycolmap.set_random_seed(0)
    if database is None:
        model = pycolmap.synthesize_dataset(options)
    else:
        with pycolmap.Database.open(database) as opened:
            model = pycolmap.synthesize_dataset(options, opened)
    rng = np.random.default_rng(0)
    for image_id in model.reg_image_ids():
        for feature in model.image(image_id).points2D:
            feature.xy = feature.xy + rng.normal(0, NOISE, 2)
    return model


def poison(model) -> list[int]:
    """A point behind the cameras that see it, one at 1e150, one that is not a number, and one so far that all rays to it are parallel."""
    image = model.image(min(model.reg_image_ids()))
    behind = image.projection_center() - 3 * image.viewing_direction()
    places = [behind, [1e150, 1e150, 1e150], [np.nan, 0.0, 1.0], image.projection_center() + 1e7 * image.viewing_direction()]
    keys = sorted(p.point3D_id for p in image.get_observation_points2D())[:4]
    for key, place in zip(keys, places, strict=True):
        model.point3D(key).xyz = np.array(place)
    return keys


def test_poisoned_points_leave_a_finite_sane_mean_and_are_gone():
    model = synthesize()
    clean = observe(model).error
    keys = poison(model)
    model.update_point_3d_errors()
    assert not np.nanmean([p.error for p in model.points3D.values()]) < 1e100, "COLMAP's own mean"
    purged = purge(model)
    assert purged.points == 4 and not purged.images
    arrays = result_arrays(model, [f"{model.image(i).name}" for i in sorted(model.reg_image_ids())])
    assert not set(keys) & set(model.points3D)
    assert arrays["residuals"].mean() == pytest.approx(clean.mean(), rel=0.05) and arrays["residuals"].max() <= 4.0
    assert np.isfinite(arrays["points"]).all() and np.abs(arrays["points"]).max() < 1e3
    assert np.isfinite(arrays["errors"]).all() and len(arrays["errors"]) == len(arrays["points"]) == len(arrays["angles"])
    assert arrays["registered"].all() and not purge(model), "nothing is left to take"


def test_one_stray_feature_goes_and_its_point_stays():
    model = synthesize()
    image = model.image(min(model.reg_image_ids()))
    feature = image.points2D[image.get_observation_point2D_idxs()[0]]
    key, before = feature.point3D_id, model.point3D(feature.point3D_id).track.length()
    feature.xy = feature.xy + np.array([30.0, 0.0])
    purged = purge(model)
    assert (purged.observations, purged.points) == (1, 0)
    assert model.point3D(key).track.length() == before - 1


def test_a_pose_that_no_sound_point_holds_is_taken_back():
    model = synthesize()
    image = model.image(min(model.reg_image_ids()))
    model.frame(image.frame_id).rig_from_world = pycolmap.Rigid3d(pycolmap.Rotation3d(np.diag([1.0, -1.0, -1.0])), np.zeros(3))
    purged = purge(model)
    assert purged.images == [image.name] and model.num_reg_images() == 7


def test_a_poisoned_model_is_refined_as_a_clean_one_is():
    model = synthesize()
    poison(model)
    after, purged, undone = refine_or_keep(model)
    assert undone is None and purged.points == 4 and after.num_reg_images() == 8
    assert observe(after).error.mean() < 2 * NOISE
    assert len(model.points3D) == 150, "the model given is as it was"


@pytest.mark.parametrize(
    ("damage", "why"),
    [
        (lambda camera: camera.params * [20.0, 1, 1, 1], "images lost their poses"),
        (lambda camera: camera.params * [1.002, 1, 1, 1], "the median error grew"),
        (lambda camera: camera.params * [np.nan, 1, 1, 1], "images lost their poses"),
    ],
)
def test_an_adjustment_that_worsens_is_undone(damage, why):
    model = synthesize()

    def adjust(worsened, fixed_lens):
        (camera,) = worsened.cameras.values()
        camera.params = np.array(damage(camera))

    kept, _, undone = refine_or_keep(model, adjust=adjust)
    assert why in undone
    assert kept.num_reg_images() == 8 and observe(kept).error.mean() < 2 * NOISE
    assert refine_or_keep(model, adjust=refine)[2] is None


def drop(model, images) -> pycolmap.Reconstruction:
    smaller = pycolmap.Reconstruction(model)
    for image_id in images:
        smaller.deregister_frame(smaller.image(image_id).frame_id)
    return smaller


def test_parts_are_disjoint_and_add_up():
    model = synthesize()
    ids = sorted(model.reg_image_ids())
    large, inside, beside = drop(model, ids[6:]), drop(model, ids[3:]), drop(model, ids[:5])
    assert parts([large, inside]) == [6], "the second part has no image of its own"
    assert parts([large, inside, beside]) == [6, 2] and parts([]) == []
    assert parts([large, beside, drop(model, ids[:6])]) == [6, 2]


@pytest.fixture
def database(tmp_path):
    return tmp_path / "database.db"


def world_errors(model, truth) -> np.ndarray:
    """Distance of every camera from the truth, after alignment, as a share of the scene."""
    from e4dgs.vision.sfm.alignment import similarity

    ids = sorted(truth.reg_image_ids())
    mine, true = (
        camera_centres(np.stack([np.vstack([m.image(i).cam_from_world().matrix(), [0, 0, 0, 1]]) for i in ids])) for m in (model, truth)
    )
    scale, R, t = similarity(mine, true)
    return np.linalg.norm(scale * mine @ R.T + t - true, axis=1) / np.linalg.norm(true - true.mean(0), axis=1).mean()


def test_frames_that_were_dropped_register_again_where_they_are_plausible(database, monkeypatch):
    """The cameras stand anywhere on a sphere, which no video does: whether they are plausible is said here."""
    truth = synthesize(10, 200, database)
    ids = sorted(truth.reg_image_ids())
    order = {truth.image(i).name: (0, n) for n, i in enumerate(ids)}
    smaller = drop(truth, ids[4:6])
    asked = []
    monkeypatch.setattr(module, "plausible", lambda centre, rotation, frame, *neighbours: asked.append(frame) or frame == 4)
    grown, merged, again = reclaim(smaller, [], database, order, False, 0)
    assert grown.num_reg_images() == 9 and again == [truth.image(ids[4]).name] and {4, 5} == set(asked)
    monkeypatch.setattr(module, "plausible", lambda *_: True)
    grown, merged, again = reclaim(smaller, [], database, order, False, 0)
    assert grown.num_reg_images() == 10 and merged == []
    assert sorted(again) == sorted(truth.image(i).name for i in ids[4:6])
    assert world_errors(grown, truth).max() < 0.01
    assert smaller.num_reg_images() == 8
    assert reclaim(smaller, [], database, {}, False, 0)[0] is smaller, "not in order of time: nothing bounds where they are"


def test_parts_that_share_images_are_joined(database):
    truth = synthesize(10, 200, database)
    ids = sorted(truth.reg_image_ids())
    large, other = drop(truth, ids[7:]), drop(truth, ids[:4])
    half_turn = pycolmap.Rotation3d(np.diag([-1.0, -1.0, 1.0]))
    other.transform(pycolmap.Sim3d(2.5, half_turn, np.array([3.0, -1.0, 7.0])))
    grown, merged, again = reclaim(large, [other], database, {}, False, 0)
    assert grown.num_reg_images() == 10 and len(merged) == 3 and again == []
    assert world_errors(grown, truth).max() < 0.01


def test_what_cannot_be_aligned_is_not_joined(database):
    truth = synthesize(10, 200, database)
    ids = sorted(truth.reg_image_ids())
    large, other = drop(truth, ids[7:]), drop(truth, ids[:4])
    rng = np.random.default_rng(0)
    for point in other.points3D.values():
        point.xyz = rng.normal(size=3)
    assert reclaim(large, [other], database, {}, False, 0)[0] is large


def test_a_similarity_is_found_among_outliers_and_not_where_there_is_none():
    rng = np.random.default_rng(2)
    source = rng.normal(size=(60, 3))
    target = 2.0 * source + [1.0, 2.0, 3.0]
    target[:20] += rng.normal(size=(20, 3)) * 5
    target[20] = np.nan
    scale, R, t = robust_similarity(source, target)
    assert scale == pytest.approx(2.0) and np.allclose(R, np.eye(3)) and np.allclose(t, [1, 2, 3])
    assert robust_similarity(source, rng.normal(size=(60, 3))) is None
    assert robust_similarity(source[21:40], target[21:40]) is None, "fewer than 20"


def test_poses_are_plausible_near_their_neighbours():
    frames = np.array([0, 1, 2, 3, 6, 7])
    centres = np.outer(frames, [1.0, 0, 0])
    rotations = np.tile(np.eye(3), (6, 1, 1))
    around = {"frames": frames, "centres": centres, "rotations": rotations}
    assert plausible(np.array([4.3, 0.5, 0]), np.eye(3), 4, **around)
    assert not plausible(np.array([40.0, 0, 0]), np.eye(3), 4, **around), "far off"
    assert not plausible(np.array([4.0, 0, 0]), np.diag([-1.0, 1.0, -1.0]), 4, **around), "looks back"
    assert plausible(np.array([9.0, 0, 0]), np.eye(3), 9, **around) and not plausible(np.array([90.0, 0, 0]), np.eye(3), 90, **around)
    assert not plausible(np.array([np.nan, 0, 0]), np.eye(3), 4, **around)


@pytest.mark.parametrize(
    ("focal", "k1", "says"),
    [
        (600.0, 0.05, None),
        (100.0, 0.0, "focal"),
        (9000.0, 0.0, "focal"),
        (600.0, -0.9, "folds"),
        (600.0, 3.0, "distortion"),
        (np.nan, 0.0, "number"),
    ],
)
def test_absurd_lenses_are_named(focal, k1, says):
    K = np.array([[focal, 0, 320], [0, focal, 240], [0, 0, 1]])
    trouble = lens_trouble(K, np.array([k1, 0, 0, 0]), 640, 480)
    assert trouble is None if says is None else says in trouble
    if says == "focal":
        assert lens_trouble(K, np.zeros(4), 640, 480, hinted=True) is None
