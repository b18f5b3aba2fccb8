"""The pictures that structure from motion gets: the capture's own files where COLMAP reads them, PNG files otherwise."""

import numpy as np
import pytest
from e4dgs.pipeline import ArtifactWriter, Context, Progress
from e4dgs.stages.poses.pictures import write_images
from e4dgs.stages.poses.settings import PosesSettings
from e4dgs.stages.shared.frameset import FrameSet
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
