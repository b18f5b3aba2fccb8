"""Depth that comes with a capture: found by its name, and used for what moves."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from e4dgs.pipeline import Artifact, ArtifactWriter
from e4dgs.scene.seeds.moving.moving_seeds import MovingSeeds
from e4dgs.stages.captures import recognise
from e4dgs.stages.captures.listing.depth_maps import add_depth
from e4dgs.stages.captures.reading import Shot
from e4dgs.stages.depth.artifact import PRECISE, StoredDepth
from e4dgs.stages.seeds.artifact import StoredSeeds, read_held
from e4dgs.stages.seeds.given_objects import given_numbers, given_surface, static_inverse
from e4dgs.stages.seeds.moving import camera_seeds
from e4dgs.stages.shared.dataset import load_frameset
from e4dgs.vision.depth.align import SCALE
from e4dgs.vision.moving.followed_parts import Objects
from factory import Options, make, render, write_nerfstudio
from moving_square import FRAMES, HEIGHT, NEAR, WALL, WIDTH, flow_of, left_edge, views, wall
from PIL import Image
from run_stage import run_frames


def square_depth(k, flow):
    return np.where(flow.moving(k) > 127, NEAR, WALL).astype(np.float32)


@pytest.mark.parametrize("error", [PRECISE / 2, PRECISE * 2])
def test_seeds_lie_at_the_given_depth(error, tmp_path):
    flow = flow_of(tmp_path / "flow")
    z = {k: square_depth(k, flow) for k in range(FRAMES)}
    given = StoredDepth(SCALE, error, z, {k: np.ones_like(one) for k, one in z.items()})
    seeds = camera_seeds(flow, views(), wall(), 125, 3000, given=given)
    assert seeds is not None and np.allclose(seeds.points[:, 2], NEAR, rtol=0.01)
    assert np.median(seeds.velocities[:, 0]) == pytest.approx(-0.2, rel=0.1), "and so they are as fast as the square"
    inverse, _ = seeds.held[4]
    assert np.allclose(inverse[inverse > 0], 1 / NEAR, rtol=0.01)


def test_pixels_that_show_what_is_at_rest_get_no_seeds_and_are_not_held(tmp_path):
    flow = flow_of(tmp_path / "flow")
    z = {k: square_depth(k, flow) for k in range(FRAMES)}
    given = StoredDepth(SCALE, PRECISE * 2, z, {k: np.ones_like(one) for k, one in z.items()})
    upper = np.zeros((HEIGHT // 2, WIDTH // 2), bool)
    upper[: HEIGHT // 4] = True
    rest = SimpleNamespace(shown=lambda i: upper)
    all_of_it, others = (camera_seeds(flow, views(), wall(), 125, 3000, given=given, rest=one) for one in (None, rest))
    whole, half = all_of_it.held[4], others.held[4]
    middle = whole.shape[1] // 2
    assert whole[:, :middle].any() and not half[:, :middle].any() and np.array_equal(whole[:, middle:], half[:, middle:])
    assert (all_of_it.points[:, 1] < -0.05).any() and len(others.points) and (others.points[:, 1] > -0.05).all()


def test_things_that_touch_in_the_picture_keep_the_depths_that_are_given(tmp_path):
    """The right half of the square is another thing, farther away; of depth that is not precise, each thing has one number."""
    flow = flow_of(tmp_path / "flow")
    z = {k: square_depth(k, flow) for k in range(FRAMES)}
    for k, one in z.items():
        one[30:70, round(left_edge(k)) + 20 :][flow.moving(k)[30:70, round(left_edge(k)) + 20 :] > 127] = 1.5 * NEAR
    given = StoredDepth(SCALE, PRECISE * 2, z, {k: np.ones_like(one) for k, one in z.items()})
    seeds = camera_seeds(flow, views(), wall(), 125, 3000, given=given)
    assert seeds is not None
    near, far = (np.isclose(seeds.points[:, 2], depth, rtol=0.02).mean() for depth in (NEAR, 1.5 * NEAR))
    assert near > 0.4 and far > 0.4 and near + far == 1


def test_noise_of_single_frames_is_averaged_over_neighbours_with_the_size():
    labels = np.zeros((HEIGHT, WIDTH), np.uint8)
    labels[20:60, 60:100] = 1
    size = np.linspace(0, 0.5, FRAMES)
    objects = Objects([labels] * FRAMES, (1.0, 1.0), [np.array([-1, 0])] * FRAMES, [np.array([0.0, one]) for one in size])
    noise = np.random.default_rng(0).normal(0, 0.05, FRAMES)
    true = 5 * np.exp(-size)
    z = {k: np.full((HEIGHT, WIDTH), true[k] * np.exp(noise[k]), np.float32) for k in range(FRAMES)}
    sure = {k: np.ones((HEIGHT, WIDTH), np.float32) for k in range(FRAMES)}
    found = {}
    for error in (0.0, 0.05):
        guessed = [np.zeros(2)] * FRAMES
        depths = np.stack(given_numbers(objects, list(range(FRAMES)), StoredDepth(SCALE, error, z, sure), guessed))
        found[error] = np.abs(np.log(depths[:, 1] / true))
    assert np.allclose(found[0.0], np.abs(noise), atol=1e-5) and found[0.05].mean() < 0.6 * np.abs(noise).mean()


@pytest.mark.parametrize("error", [0.0, PRECISE * 2])
def test_the_rim_of_an_object_which_shows_what_is_behind_says_nothing(error):
    labels = np.zeros((30, 40), np.uint8)
    labels[5:25, 10:14] = 1
    z = np.full((30, 40), 8.0, np.float32)
    z[6:24, 11:13] = 2.0
    objects = Objects([labels], (1.0, 1.0), [np.array([-1, 0])], [np.zeros(2)])
    given = StoredDepth(SCALE, error, {0: z}, {0: np.ones_like(z)})
    (numbers,) = given_numbers(objects, [0], given, [np.zeros(2)])
    assert numbers[1] == pytest.approx(2.0), "most of its pixels are rim"
    thin = Objects([np.where(labels > 0, 1, 0)[:, 10:13].astype(np.uint8)], (1.0, 1.0), [np.array([-1, 0])], [np.zeros(2)])
    near = StoredDepth(SCALE, error, {0: np.full((30, 3), 3.0, np.float32)}, {0: np.ones((30, 3), np.float32)})
    assert given_numbers(thin, [0], near, [np.zeros(2)])[0][1] == pytest.approx(3.0), "nothing but rim is better than nothing"


def test_pixels_of_something_else_have_their_objects_depth():
    z = np.full((4, 4), 5.0, np.float32)
    z[0, 0], z[1, 1] = 9.0, 0.0
    given = StoredDepth(SCALE, 0.0, {0: z}, {0: np.ones_like(z)})
    labels = np.ones((4, 4), np.uint8)
    surface = given_surface(given, 0, labels, np.full((4, 4), 4.8))
    assert surface[0, 0] == surface[1, 1] == 4.8 and surface[2, 2] == 5.0
    assert (given_surface(replace(given, error=0.1), 0, labels, np.full((4, 4), 4.8)) == 4.8).all(), "all of it is rim"


def test_noisy_depth_gives_the_shape_of_a_part_in_windows():
    """A part that is deeper on its right, seen with noise from pixel to pixel: nearer to the truth than one number, and than the noise."""
    height, width = 120, 240
    labels = np.zeros((height, width), np.uint8)
    labels[20:100, 60:180] = 1
    true = np.full((height, width), 8.0)
    true[labels > 0] = np.broadcast_to(np.linspace(2.8, 3.3, width), (height, width))[labels > 0]
    noise = np.random.default_rng(0).normal(0, 0.05, (height, width))
    z = (true * np.exp(noise)).astype(np.float32)
    z[40:60, 60:70] = 8.0  # a hole, through which the wall shows
    given = StoredDepth(SCALE, PRECISE * 2, {0: z}, {0: np.ones_like(z)})
    number = np.where(labels > 0, float(np.percentile(true[labels > 0], 40)), 5.0)
    surface = given_surface(given, 0, labels, number)
    wrong, flat = (np.abs(np.log(one / true))[labels > 0] for one in (surface, number))
    assert np.median(wrong) < 0.01 < 0.5 * np.median(flat) and wrong.max() < 0.06
    assert (surface[labels == 0] == 5.0).all()


def test_what_is_at_rest_is_filled_up_where_pixels_are_to_be_believed():
    z = {0: np.full((8, 8), 4.0, np.float32), 1: np.full((8, 8), 4.0, np.float32)}
    sure = {0: np.ones((8, 8), np.float32), 1: np.ones((8, 8), np.float32)}
    sure[1][0, 0] = 0.2
    swept = {0: np.zeros((4, 4), np.float32)}
    swept[0][1, 1] = 0.5
    filled = static_inverse(StoredDepth(SCALE, 0.01, z, sure), swept)
    assert filled[0][1, 1] == 0.5 and filled[0][0, 0] == 0.25 and filled[1][0, 0] == 0 and filled[1][3, 3] == 0.25
    wide = StoredDepth(SCALE, 0.01, *({k: np.repeat(one, 90, axis=1) for k, one in each.items()} for each in (z, sure)))
    finer = static_inverse(wide, swept)
    assert {one.shape for one in finer.values()} == {(4, 4)}, "maps of one size, whatever that of the depth"
    assert static_inverse(StoredDepth(SCALE, 0.05, z, sure), swept) == swept


@pytest.fixture
def capture(tmp_path):
    """A capture of 8 frames with 16-bit depth beside its images, but for the last one, and half of its size."""
    made = make(Options(backdrop="room", rig="path", times=8, width=48, height=32))
    written = write_nerfstudio(made, tmp_path / "capture")
    (written.root / "depth").mkdir()
    for view, file in list(zip(written.views, written.files, strict=True))[:-1]:
        depth = render(made.scene, view.camera, view.time, samples=1).depth[::2, ::2]
        name = file.removeprefix("images/").rsplit(".", 1)[0]
        Image.fromarray(np.rint(1000 * depth).astype(np.uint16)).save(written.root / "depth" / f"{name}.png")
    return written


def test_depth_beside_images_is_found_and_read(capture, tmp_path):
    ran = run_frames(capture.root, tmp_path / "run")
    assert "7 of 8 images have a depth map (first depth/" in "\n".join(ran.context.capture.notes)
    frames = load_frameset({"frames": ran.artifact}, capture.root)
    depth, confidence = frames.depth(2)
    truth = render(capture.synthetic.scene, capture.views[2].camera, capture.views[2].time, samples=1).depth
    assert depth.shape == truth.shape and np.median(np.abs(depth / 1000 / truth - 1)) < 0.02 and (confidence == 1).all()
    assert frames.depth(7) is None
    assert {f"depth/{p.name}" for p in (capture.root / "depth").iterdir()} <= set(ran.context.capture.files), "results depend on them"


def test_maps_of_another_shape_and_broken_ones_are_left_out(capture, tmp_path):
    first, second, *_ = sorted((capture.root / "depth").iterdir())
    Image.fromarray(np.ones((32, 32), np.uint16)).save(first)
    second.write_bytes(b"no picture")
    notes = "\n".join(run_frames(capture.root, tmp_path / "run").context.capture.notes)
    assert "5 of 8 images have a depth map" in notes
    assert f"the depth map depth/{first.name} is not read: depth must have the shape of its picture; export it" in notes
    assert f"the depth map depth/{second.name} is not read: such a file cannot be opened; copy it again" in notes and "layout" not in notes


@pytest.mark.parametrize("suffix", [".npy", ".exr", ".png"])
@pytest.mark.parametrize("what", ["depth", "confidence"])
def test_maps_of_another_part_of_the_view_are_not_stretched(tmp_path, suffix, what):
    """Depth of 4:3 beside pictures of 16:9, as a sensor of its own gives it."""

    def save(file, width, height):
        values = np.ones((height, width), np.float32)
        if suffix == ".exr":
            header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
            OpenEXR.File(header, {"Z": values}).write(str(file))
        elif suffix == ".npy":
            np.save(file, values)
        else:
            Image.fromarray(values.astype(np.uint16)).save(file)

    OpenEXR = pytest.importorskip("OpenEXR") if suffix == ".exr" else None
    for folder in ("depth", "confidence"):
        (tmp_path / folder).mkdir()
        save(tmp_path / folder / f"a{suffix}", 16, 9)
        save(tmp_path / folder / f"b{suffix}", *((16, 12) if folder == what else (16, 9)))
    shots = [Shot(name=f"{name}.png", camera=0, time=0.0, size=(64, 36), file=f"{name}.png") for name in "ab"]
    notes, files = add_depth(tmp_path, shots)
    assert [bool(shot.depth) for shot in shots] == [True, what != "depth"] and shots[0].depth_confidence and not shots[1].depth_confidence
    assert notes[-1].startswith(f"the {what} map {what}/b{suffix} is not read: {what} must have the shape of its picture; export it")
    assert notes[-1].endswith("(it is 16x12, its picture 64x36)") and f"{what}/b{suffix}" in files


def test_why_depth_is_not_read_is_true(capture):
    """Files of `depth_file_path` whose pictures are colours, depth with other names than its pictures, and depth of pictures not taken."""
    data = json.loads((capture.root / "transforms.json").read_text())
    (capture.root / "depth").rename(capture.root / "deep")
    for frame, file in zip(data["frames"], sorted((capture.root / "deep").iterdir()), strict=False):
        frame["depth_file_path"] = f"deep/{file.name}"
        Image.new("RGB", (48, 32)).save(file)
    (capture.root / "transforms.json").write_text(json.dumps(data))
    (note,) = [note for note in recognise(capture.root).notes if "depth map" in note]
    assert (
        note.startswith("7 depth maps (first deep/") and "are not read: a picture of depth must have one channel of grey, not RGB" in note
    )
    (capture.root / "transforms.json").unlink()
    (capture.root / "deep").rename(capture.root / "depth")
    for file in (capture.root / "depth").iterdir():
        Image.new("I;16", (48, 32), 1000).save(file)
    assert not [note for note in recognise(capture.root, every=2).notes if "depth" in note and "not read" in note]
    for file in (capture.root / "depth").iterdir():
        file.rename(file.with_name(f"{file.stem}_depth.png"))
    (note,) = [note for note in recognise(capture.root).notes if "depth" in note]
    first = min((capture.root / "images").iterdir())
    assert note.startswith("7 depth maps (first depth/") and note.endswith(
        f"are not read, because depth is read by the name of its picture: that of images/{first.name} would be depth/{first.stem}.png"
    )


@pytest.mark.parametrize(
    ("picture", "depth"),
    [
        ("images/a.jpg", "depth/a.npy"),
        ("a.jpg", "depth/a.png"),
        ("keyframes/corrected_images/17.jpg", "keyframes/depth/17.png"),
        ("rgb/2x/0_00001.png", "depth/2x/0_00001.npy"),
        ("frame-000003.color.png", "frame-000003.depth.png"),
        ("rgb/1305.031.png", "depth/1305.042.png"),
        ("rgbd/7.jpg", "rgbd/7.depth"),
        ("rgb/7.jpg", "depth/7.exr"),
        ("images/a.jpg", None),
        ("rgb/1305.031.png", None),
    ],
)
def test_where_depth_is_found(picture, depth, tmp_path):
    for name in ("depth/b.png", "depth/1306.042.png", *([depth] if depth else [])):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        if name.endswith((".npy", ".depth", ".exr")):
            np.save((tmp_path / name).open("wb"), np.ones((4, 6), np.float32))  # the content is looked at later
        else:
            Image.fromarray(np.ones((4, 6), np.uint16)).save(tmp_path / name)
    shot = Shot(name=picture, camera=0, time=0.0, size=(12, 8), file=picture)
    assert bool(add_depth(tmp_path, [shot])[0]) is bool(depth) and shot.depth == depth


def test_the_artifact_of_seeds_has_the_depth_at_which_things_are_held(tmp_path):
    held = {5: np.ones((2, 4, 6), np.float32), 4: np.zeros((2, 4, 6), np.float32)}
    seeds = StoredSeeds(
        points=np.zeros((2, 3)),
        colors=np.zeros((2, 3)),
        dynamic=np.zeros(2, bool),
        moving=MovingSeeds(np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3), held),
        depth={},
        near=0.1,
        background=(0.0, 0.0, 0.0),
        path_width=None,
    )
    out = ArtifactWriter(tmp_path)
    seeds.write(out, b"png")
    out.finish({})
    maps = read_held(Artifact(tmp_path))
    assert sorted(maps) == [4, 5] and (maps[5] == 1).all() and (maps[4] == 0).all()
    again = StoredSeeds.read(Artifact(tmp_path))
    assert again.moving is not None and sorted(again.moving.held) == [4, 5]
    assert read_held(None) == {}
