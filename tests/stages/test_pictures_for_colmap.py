"""The pictures that structure from motion gets: the capture's own files where COLMAP reads them, PNG files otherwise."""

import numpy as np
import pytest
from e4dgs.pipeline import ArtifactWriter, Context, Progress
from e4dgs.stages.poses.lens_groups import joined, lens_groups
from e4dgs.stages.poses.pictures import write_images
from e4dgs.stages.poses.settings import PosesSettings
from e4dgs.stages.shared.frameset import FrameSet
from e4dgs.vision.images.focal_length import ExifLens
from PIL import Image
from run_stage import run_frames

KINDS = ("PNG", "JPEG", "BMP", "TIFF", "WEBP", "DIB")


def pictures_of(folder, work):
    """Names of the files for COLMAP, and the folder that they are in."""
    ran = run_frames(folder, work)
    context = Context(
        ran.context.capture, {}, PosesSettings(), {}, ArtifactWriter(work / "out"), work / "checkpoints", "cpu", print, Progress
    )
    return write_images(context, FrameSet(ran.artifact, folder)), work / "checkpoints/images"


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("suffix", [".png", ".jpg", ".webp"])
def test_colmap_reads_every_picture_that_we_read(tmp_path, kind, suffix):
    """The content decides, whatever the name says. A WebP file that is linked would end structure from motion."""
    pycolmap = pytest.importorskip("pycolmap")
    folder = tmp_path / "capture"
    folder.mkdir()
    (tmp_path / "work/out").mkdir(parents=True)
    shown = np.random.default_rng(0).integers(0, 256, (2, 24, 32), dtype=np.uint8)
    for i in range(2):
        Image.fromarray(shown[i]).convert("RGB").save(folder / f"{i}{suffix}", format=kind, quality=100, lossless=True)
    names, where = pictures_of(folder, tmp_path / "work")
    assert [(where / name).is_symlink() for name in names] == [kind not in ("WEBP", "DIB")] * 2
    for i, name in enumerate(names):
        read = pycolmap.Bitmap.read(str(where / name), False)
        assert read is not None and np.abs(read.to_array().astype(int) - shown[i]).max() <= (8 if kind == "JPEG" else 0)


def test_one_file_that_colmap_cannot_read_is_enough_to_write_all(tmp_path):
    """Linked files keep their size, while written ones are scaled to the frames, and one lens cannot have both."""
    folder = tmp_path / "capture"
    folder.mkdir()
    (tmp_path / "work/out").mkdir(parents=True)
    for i, kind in enumerate(("PNG", "WEBP", "PNG")):
        Image.new("RGB", (32, 24)).save(folder / f"{i}.png", format=kind)
    names, where = pictures_of(folder, tmp_path / "work")
    assert names == ["000000.png", "000001.png", "000002.png"] and not any((where / name).is_symlink() for name in names)


def photo(file, focal=None, size=(64, 48), tag=0xA405, model="Phone 12"):
    exif = Image.Exif()
    exif[0x0110] = model
    exif[0x8769] = {} if focal is None else {tag: focal}
    Image.effect_noise(size, 40).convert("RGB").save(file, exif=exif)


def groups_of(folder, work):
    work.mkdir()
    ran = run_frames(folder, work)
    return lens_groups(FrameSet(ran.artifact, folder))


def test_photos_of_one_size_with_other_focal_lengths_have_other_lenses(tmp_path):
    """As phones take them with 0.5x, 1x and 3x. Each lens begins with its own focal length."""
    pycolmap = pytest.importorskip("pycolmap")
    from e4dgs.vision.sfm.worker.reconstruct import first_camera

    folder = tmp_path / "capture"
    folder.mkdir()
    focals = (26, 26, 13, 13, 26, 77, 13, 77, 77)
    for i, focal in enumerate(focals):
        photo(folder / f"{i}.jpg", focal)
    groups, told = groups_of(folder, tmp_path / "a")
    assert groups == [0, 0, 1, 1, 0, 2, 1, 2, 2]
    assert told is not None and "tell 3 lenses apart" in told and "3 at 13 mm (35 mm equivalent) of Phone 12" in told
    (tmp_path / "work/out").mkdir(parents=True)
    names, where = pictures_of(folder, tmp_path / "work")
    for i in (0, 2, 5):
        camera = first_camera(where / names[i], {"camera_model": "SIMPLE_RADIAL", "width": 64, "height": 48})
        assert isinstance(camera, pycolmap.Camera) and camera.mean_focal_length() == pytest.approx(focals[i] / 36 * 64, rel=0.05)


def test_without_a_35_mm_focal_length_the_real_one_and_the_camera_count(tmp_path):
    folder = tmp_path / "capture"
    folder.mkdir()
    kinds = [(4.25, "A"), (4.25, "A"), (4.25, "A"), (1.54, "A"), (1.54, "A"), (1.54, "A"), (4.25, "B"), (4.25, "B"), (4.25, "B")]
    for i, (focal, model) in enumerate(kinds):
        photo(folder / f"{i}.jpg", focal, tag=0x920A, model=model)
    assert groups_of(folder, tmp_path / "a")[0] == [0, 0, 0, 1, 1, 1, 2, 2, 2]


def test_photos_that_say_nothing_share_a_lens_as_those_that_say_the_same(tmp_path):
    for name, focals in (("without", [None] * 6), ("some", [26, None, 26, None, 26, None]), ("same", [26] * 6)):
        folder = tmp_path / name
        folder.mkdir()
        for i, focal in enumerate(focals):
            photo(folder / f"{i}.jpg", focal)
        assert groups_of(folder, tmp_path / f"{name}-work") == ([0] * 6, None)


def test_few_photos_join_the_nearest_focal_length_within_5_percent():
    """A zoom states another focal length in nearly every photo."""

    def focal_groups(*focals):
        found = joined([None if focal is None else ExifLens(focal, True, "") for focal in focals])
        return [list(dict.fromkeys(found)).index(lens) for lens in found]

    assert focal_groups(24, 24, 24, 25, 35, 35, 35, 30) == [0, 0, 0, 0, 1, 1, 1, 2]
    assert (focal_groups(100, 100, 100, 105), focal_groups(100, 100, 100, 106)) == ([0, 0, 0, 0], [0, 0, 0, 1])
    assert focal_groups(50, 50, 50, 51, 51, 51) == [0, 0, 0, 1, 1, 1]
    zoom = [24 * 1.03**k for k in range(30)]
    groups = focal_groups(*zoom)
    for group in set(groups):
        mine = [focal for focal, other in zip(zoom, groups, strict=True) if other == group]
        assert max(mine) / min(mine) < 1.16, "neighbours do not chain a whole zoom"
    assert len(set(groups)) < 16
    assert focal_groups(26, 26, 26, 13, 13, 13, None, None) == [0, 0, 0, 1, 1, 1, 0, 0]
    assert focal_groups(26, 26, 26, 13, 13, 13, None, None, None) == [0, 0, 0, 1, 1, 1, 2, 2, 2]


def test_a_cropped_photo_keeps_its_focal_length(tmp_path):
    """Photos of two sizes are cut to one; the focal length in EXIF data is that of the whole."""
    pytest.importorskip("pycolmap")
    from e4dgs.vision.sfm.worker.reconstruct import first_camera

    folder = tmp_path / "capture"
    folder.mkdir()
    for i, size in enumerate(((64, 48), (64, 48), (64, 36), (64, 36))):
        photo(folder / f"{i}.jpg", 27, size)
    (tmp_path / "work/out").mkdir(parents=True)
    (tmp_path / "b").mkdir()
    frames = FrameSet(run_frames(folder, tmp_path / "b").artifact, folder)
    names, where = pictures_of(folder, tmp_path / "work")
    assert frames.crop is not None
    for i, name in enumerate(names):
        camera = first_camera(where / name, {"camera_model": "SIMPLE_RADIAL", "width": frames.width, "height": frames.height})
        expected = 27 / 36 * 64 * frames.width / frames.crop[i][2]
        assert camera.has_prior_focal_length and camera.mean_focal_length() == pytest.approx(expected, rel=0.06)
