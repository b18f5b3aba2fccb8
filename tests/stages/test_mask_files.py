"""Files of masks: photos that EXIF data turn, 16 bits, flat folders, and folders of masks that nothing looks at."""

import shutil

import numpy as np
import pytest
from e4dgs.pipeline import CaptureError
from e4dgs.stages.captures import recognise
from e4dgs.stages.shared.frameset import FrameSet
from e4dgs.vision.images.pictures import read_keep, read_mask, read_picture
from PIL import Image, ImageOps
from run_stage import run_frames


def photos(root, orientations, size=(16, 12)):
    """Photos whose red half is hidden by a mask of the stored size; orientations: of EXIF, one a photo."""
    (root / "masks").mkdir(parents=True)
    for i, orientation in enumerate(orientations):
        picture = np.full((size[1], size[0], 3), (0, 0, 200), np.uint8)
        picture[: size[1] // 3, : size[0] // 2] = (200, 0, 0)
        exif = Image.Exif()
        exif[0x0112] = orientation
        Image.fromarray(picture).save(root / f"{i}.png", exif=exif)
        Image.fromarray(np.where(picture[..., 0] > 0, 0, 255).astype(np.uint8)).save(root / f"masks/{i}.png")
    return root


def frameset(root, folder):
    return FrameSet(run_frames(root, folder).artifact, root)


def test_masks_of_the_stored_size_turn_with_their_photos(tmp_path):
    """All eight orientations; the odd size of the hidden corner tells each from the others."""
    root = photos(tmp_path / "photos", range(1, 9))
    for i in range(8):
        picture = read_picture(root, f"{i}.png", upright=True)
        mask = read_mask(root, f"masks/{i}.png", i + 1)
        np.testing.assert_array_equal(mask == 0, picture[..., 0] == 200, err_msg=f"orientation {i + 1}")
    frames = frameset(photos(tmp_path / "lying", [5, 6, 7, 8]), tmp_path / "out")
    assert frames.keep_turns == [5, 6, 7, 8] and (frames.width, frames.height) == (12, 16)
    for i in range(4):
        np.testing.assert_array_equal(frames.kept(i), frames.image(i)[..., 0] == 0)


def test_masks_that_lie_as_their_photos_are_shown_stay(tmp_path):
    root = photos(tmp_path / "photos", [6, 8, 6])
    for i, orientation in enumerate((6, 8, 6)):
        mask = Image.open(root / f"masks/{i}.png")
        mask.getexif()[0x0112] = orientation
        ImageOps.exif_transpose(mask).save(root / f"masks/{i}.png", exif=Image.Exif())
    frames = frameset(root, tmp_path / "out")
    assert frames.keep_turns == [1, 1, 1]
    for i in range(3):
        np.testing.assert_array_equal(frames.kept(i), frames.image(i)[..., 0] == 0)


def test_sizes_of_other_masks_say_how_a_half_turned_one_lies(tmp_path):
    stored = photos(tmp_path / "stored", [6, 3])
    assert recognise(stored).keep_turns == (6, 3)
    Image.open(stored / "masks/0.png").transpose(Image.Transpose.ROTATE_270).save(stored / "masks/0.png")
    assert recognise(stored).keep_turns == (1, 1)
    assert recognise(photos(tmp_path / "half", [3, 3])).keep_turns == (3, 3), "nothing tells: as COLMAP's are"
    assert recognise(photos(tmp_path / "square", [6, 1], (12, 12))).keep_turns == (6, 1)


def test_a_mask_of_another_size_is_refused_whatever_its_photo_is(tmp_path):
    root = photos(tmp_path / "photos", [6, 6])
    Image.new("L", (8, 6), 255).save(root / "masks/1.png")
    with pytest.raises(CaptureError, match=r"masks/1\.png: the mask is 8x6, its image 12x16"):
        recognise(root)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_masks_of_zeros_and_ones_are_truth_values(tmp_path, dtype):
    """As NumPy's bool is saved as uint8. From 2 on a value says how bright a mask is, and all of that is black here."""
    values = np.array([[0, 1, 0], [1, 1, 0]], dtype)
    Image.fromarray(values).save(tmp_path / "truth.png")
    np.testing.assert_array_equal(read_keep(tmp_path, "truth.png"), 255 * values)
    Image.fromarray(2 * values).save(tmp_path / "dark.png")
    with pytest.raises(CaptureError, match="black everywhere"):
        read_keep(tmp_path, "dark.png")
    root = photos(tmp_path / "photos", [1, 1])
    for i in range(2):
        Image.fromarray(np.eye(12, 16, dtype=dtype)).save(root / f"masks/{i}.png")
    assert any(
        "masks hold only 0 and 1, of which 1 is taken for white (2 masks)" in line for line in run_frames(root, tmp_path / "out").lines
    )


@pytest.mark.parametrize("grey", [0, 255, 90])
@pytest.mark.parametrize("mode", ["RGBA", "LA", "P"])
def test_masks_of_one_colour_hold_their_shape_in_alpha(tmp_path, grey, mode):
    shape = np.array([[0, 255, 0, 40], [255, 255, 0, 200]], np.uint8)
    if mode == "P":
        shape = np.where(shape > 127, 255, 0).astype(np.uint8)
        image = Image.fromarray(shape // 255, "P")
        image.putpalette([grey] * 6)
        image.save(tmp_path / "alpha.png", transparency=bytes([0, 255]))
    else:
        bands = [Image.fromarray(np.full_like(shape, grey))] * (len(mode) - 1)
        Image.merge(mode, [*bands, Image.fromarray(shape)]).save(tmp_path / "alpha.png")
    said = []
    np.testing.assert_array_equal(read_mask(tmp_path, "alpha.png", say=said.append), shape)
    np.testing.assert_array_equal(read_keep(tmp_path, "alpha.png"), np.where(shape > 127, 255, 0))
    assert len(said) == 1 and "alpha" in said[0]


@pytest.mark.parametrize("mode", ["RGBA", "LA"])
@pytest.mark.parametrize("hidden", [0, 255, None], ids=["black", "white", "kept"])
def test_cut_outs_hold_their_mask_in_alpha(tmp_path, mode, hidden):
    """Whatever the colours below it are. The object is small, bright and dark."""
    colours = np.random.default_rng(3).integers(0, 256, (20, 30, 4), dtype=np.uint8)
    shape = np.zeros((20, 30), np.uint8)
    shape[4:9, 10:17], shape[4, 10:17] = 255, 90
    if hidden is not None:
        colours[shape == 0] = hidden
    bands = [*(colours[..., k] for k in range(len(mode) - 1)), shape]
    root = photos(tmp_path / "photos", [1, 1], (30, 20))
    for i in range(2):
        Image.merge(mode, [Image.fromarray(band) for band in bands]).save(root / f"masks/{i}.png")
    np.testing.assert_array_equal(read_mask(root, "masks/0.png"), shape)
    lines = run_frames(root, tmp_path / "out").lines
    assert any("masks are pictures that are cut out, of which opaque is taken for white" in line and "(2 masks)" in line for line in lines)


def test_alpha_of_masks_that_have_a_shape_in_grey_counts_for_nothing(tmp_path):
    grey = np.array([[0, 255], [255, 0]], np.uint8)
    for name, first, alpha in (
        ("both", grey, grey[::-1]),
        ("opaque", grey, np.full_like(grey, 255)),
        ("plain", np.full_like(grey, 255), None),
    ):
        bands = [Image.fromarray(first)] * 3 + [Image.fromarray(np.full_like(grey, 7) if alpha is None else alpha)]
        Image.merge("RGBA", bands).save(tmp_path / f"{name}.png")
        np.testing.assert_array_equal(read_mask(tmp_path, f"{name}.png"), first)


def test_masks_of_sixteen_bits_are_scaled_and_not_clipped(tmp_path):
    values = np.array([[0, 1, 32000], [33000, 300, 65535]], np.uint16)
    Image.fromarray(values).save(tmp_path / "deep.png")
    np.testing.assert_array_equal(read_mask(tmp_path, "deep.png"), np.rint(values / 257))
    np.testing.assert_array_equal(read_keep(tmp_path, "deep.png"), [[0, 0, 0], [255, 0, 255]])


@pytest.mark.parametrize("name", ["003.png.png", "003.png"])
def test_a_flat_folder_of_photos_may_hold_masks(images_capture, tmp_path, name):
    root = shutil.copytree(images_capture.root, tmp_path / "photos")
    (root / "masks").mkdir()
    Image.new("L", (96, 80), 255).save(root / "masks" / name)
    capture = recognise(root)
    assert capture.facts["format"] == "images" and capture.keeps[3] == f"masks/{name}" and sum(map(bool, capture.keeps)) == 1
    assert any("1 of 10 images have a mask in masks/" in note for note in capture.notes)
    (root / "masks" / name).rename(root / "masks/other.png")
    assert any("expected masks/NAME.png for NAME" in note for note in recognise(root).notes)


def test_masks_that_no_one_looks_at_are_spoken_of(dnerf_capture, n3v_capture, video_capture, images_capture, tmp_path):
    def notes(source, name):
        folder = tmp_path / name
        shutil.copytree(source, folder) if source.is_dir() else (folder.mkdir(), shutil.copy(source, folder))
        before = recognise(folder).notes
        (folder / "masks").mkdir()
        return [note for note in recognise(folder).notes if note not in before]

    for source, kind in ((dnerf_capture.root, "dnerf"), (n3v_capture.root, "n3v"), (video_capture.root, "video")):
        (note,) = notes(source, kind)
        assert "masks/ is ignored" in note and f"the layout is {kind}" in note and "mask_path" in note
    shutil.copytree(images_capture.root, tmp_path / "room/images")
    (tmp_path / "room/masks").mkdir()
    assert any("masks/ is ignored" in note and "folder that holds both" in note for note in recognise(tmp_path / "room/images").notes)
    assert not any("is ignored" in note for note in recognise(tmp_path / "room").notes)


BESIDE = ("{}_mask.png", "{}.png.mask.png", "{}.mask.png", "{}_MASK.PNG")  # of 3DGRUT and NCore, RealityScan, and as Windows writes it


def with_masks(source, folder, at, pattern):
    """A copy of a capture in which all pictures but the last have masks; its flat folder of photos, if it has no poses."""
    root = shutil.copytree(source, folder)
    photos = root / "images" if (root / "images").is_dir() else root
    (root / "masks").mkdir(exist_ok=True) if at == "masks" else None
    for photo in sorted(photos.glob("*.png"))[:-1]:
        Image.new("L", Image.open(photo).size, 255).save((root / "masks" if at == "masks" else photos) / pattern.format(photo.stem))
    return root


@pytest.mark.parametrize("at", ["beside", "masks"])
@pytest.mark.parametrize("pattern", BESIDE)
@pytest.mark.parametrize("layout", ["colmap", "nerfstudio", "images"])
def test_masks_may_lie_beside_their_pictures(request, tmp_path, layout, pattern, at):
    source = request.getfixturevalue(f"{layout}_capture").root
    plain, root = recognise(source), with_masks(source, tmp_path / "capture", at, pattern)
    capture = recognise(root)
    assert capture.images == plain.images and capture.keeps[-1] is None and len(set(capture.keeps)) == len(plain.images)
    assert all(keep in capture.files for keep in capture.keeps[:-1])
    (note,) = [note for note in capture.notes if note not in plain.notes]
    where = "in masks/" if at == "masks" else "beside them"
    assert note.startswith(f"{len(plain.images) - 1} of {len(plain.images)} images have a mask {where}; its black")


def test_a_photo_is_no_mask_of_another(colmap_capture, tmp_path):
    """Because it has a pose of its own."""
    root = shutil.copytree(colmap_capture.root, tmp_path / "capture")
    images = root / "sparse/0/images.txt"
    images.write_text(images.read_text().replace("001.png", "000_mask.png"))
    (root / "images/001.png").rename(root / "images/000_mask.png")
    assert recognise(root).keeps is None


@pytest.mark.parametrize("layout", ["colmap", "nerfstudio", "images"])
def test_masks_whose_white_is_ignored_are_named_and_not_read(request, tmp_path, layout):
    """instant-ngp's mean the opposite of all others."""
    source = request.getfixturevalue(f"{layout}_capture").root
    plain, root = recognise(source), with_masks(source, tmp_path / "capture", "beside", "dynamic_mask_{}.png")
    if layout == "colmap":  # the line on pictures that were left out on purpose does not silence it
        Image.open(root / "images/000.png").save(root / "images/extra.png")
    capture = recognise(root)
    assert capture.images == plain.images and capture.keeps is None
    told = [note for note in capture.notes if note not in plain.notes]
    assert told[-1].startswith(f"{len(plain.images) - 1} masks of instant-ngp (first ") and "invert them" in told[-1]
    assert told[:-1] == (["1 images without a pose in sparse/0 are left out"] if layout == "colmap" else [])


def test_masks_beside_pictures_of_a_layout_without_them_are_named(dnerf_capture, tmp_path):
    root = shutil.copytree(dnerf_capture.root, tmp_path / "capture")
    Image.new("L", (64, 64), 255).save(root / "train/r_000_mask.png")
    (note,) = [note for note in recognise(root).notes if "mask" in note]
    assert note.startswith("the mask train/r_000_mask.png is not read, because the layout is dnerf; masks are read from ")
