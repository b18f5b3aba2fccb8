"""A capture in a .zip file: the same as its folder, and no way out of it."""

import os
import shutil
import stat
import zipfile
from pathlib import Path

import pytest
from e4dgs.pipeline import CaptureError
from e4dgs.workflows.session import Options, open_session
from e4dgs.workflows.storage import archive as module
from e4dgs.workflows.storage.archive import unpacked


def packed(folder: Path, file: Path, under: str = "") -> Path:
    with zipfile.ZipFile(file, "w") as archive:
        for path in sorted(folder.rglob("*")):
            archive.write(path, Path(under) / path.relative_to(folder))
    return file


@pytest.mark.parametrize("under", ["", "some/folder"])
def test_an_archive_is_the_capture_that_it_holds(colmap_capture, tmp_path, under):
    file = packed(colmap_capture.root, tmp_path / "band.zip", under)
    zipped = open_session(Options(file, tmp_path / "work"))
    plain = open_session(Options(colmap_capture.root, tmp_path / "work"))
    assert zipped.job.capture.facts == plain.job.capture.facts and zipped.job.capture.names == plain.job.capture.names
    assert zipped.job.capture.root.is_relative_to(tmp_path / "work" / "unpacked")
    assert zipped.scene.capture == file


def test_it_is_unpacked_once_and_again_when_it_changes(colmap_capture, tmp_path):
    file = packed(colmap_capture.root, tmp_path / "a.zip")
    first = unpacked(file, tmp_path / "work")
    (first / "mark").touch()
    assert unpacked(file, tmp_path / "work") == first and (first / "mark").exists()
    before = file.stat()
    file.touch()
    assert unpacked(file, tmp_path / "work") == first
    packed(colmap_capture.root, file, "other")
    os.utime(file, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert unpacked(file, tmp_path / "work") != first
    copy = shutil.copy(file, tmp_path / "b.zip")
    assert unpacked(Path(copy), tmp_path / "work").is_relative_to(tmp_path / "work" / "unpacked"), "a copy's folder has its name"


def test_a_video_alone_in_an_archive_is_the_capture(tmp_path):
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "clip.mp4").write_bytes(b"video")
    assert unpacked(packed(tmp_path / "in", tmp_path / "v.zip"), tmp_path / "work").name == "clip.mp4"


def test_what_macos_adds_to_an_archive_does_not_count(images_capture, tmp_path):
    """Beside the one folder, and inside it: `.DS_Store`, and `__MACOSX` with a `._name` for every file."""
    for file in sorted(images_capture.root.iterdir()):
        (tmp_path / "in/room/images").mkdir(parents=True, exist_ok=True)
        shutil.copy(file, tmp_path / "in/room/images")
    (tmp_path / "in/room/README.txt").write_text("words")
    for folder in ("in", "in/room"):
        (tmp_path / folder / "__MACOSX/room").mkdir(parents=True)
        (tmp_path / folder / "__MACOSX/room/._000.png").write_bytes(b"x")
        (tmp_path / folder / ".DS_Store").write_bytes(b"x")
    for k, inside in enumerate(("in", "in/room")):
        session = open_session(Options(packed(tmp_path / inside, tmp_path / f"{k}.zip"), tmp_path / "work"))
        assert session.job.capture.facts["frames"] == len(images_capture.files)
        assert session.job.capture.names[0].startswith("images/")


def test_what_is_no_archive_is_left_alone(tmp_path):
    (tmp_path / "folder.zip").mkdir()
    for path in (tmp_path / "folder.zip", tmp_path / "absent.zip", tmp_path):
        assert unpacked(path, tmp_path / "work") == path
    assert not (tmp_path / "work").exists()


@pytest.mark.parametrize("name", ["../out.png", "a/../../out.png", "/tmp/out.png", "C:/out.png", "..\\\\out.png"])
def test_nothing_leaves_the_folder(tmp_path, name):
    file = tmp_path / "bad.zip"
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("fine.png", b"")
        archive.writestr(zipfile.ZipInfo(name), b"x")
    with pytest.raises(CaptureError, match="leads out"):
        unpacked(file, tmp_path / "work")
    assert not list((tmp_path / "work" / "unpacked").iterdir()), "nothing half-unpacked is left"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bad.zip", "work"]


def test_links_bombs_and_damage_are_refused(tmp_path, monkeypatch):
    link = zipfile.ZipInfo("link.png")
    link.external_attr = (stat.S_IFLNK | 0o777) << 16
    with zipfile.ZipFile(tmp_path / "link.zip", "w") as archive:
        archive.writestr(link, "/etc/hostname")
    with pytest.raises(CaptureError, match="is a link"):
        unpacked(tmp_path / "link.zip", tmp_path / "work")
    with zipfile.ZipFile(tmp_path / "bomb.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("zeros", bytes(3_000_000))
    monkeypatch.setattr(module, "SLACK", 0)
    with pytest.raises(CaptureError, match="too many for a capture"):
        unpacked(tmp_path / "bomb.zip", tmp_path / "work")
    (tmp_path / "cut.zip").write_bytes((tmp_path / "bomb.zip").read_bytes()[:200])
    with pytest.raises(CaptureError, match="cannot be unpacked"):
        unpacked(tmp_path / "cut.zip", tmp_path / "work")
