"""Archives as Windows, macOS and tar write them, and those that are only named."""

import io
import tarfile
import unicodedata
import zipfile
from pathlib import Path

import pytest
from e4dgs.pipeline import CaptureError
from e4dgs.stages.captures import recognise
from e4dgs.workflows.storage import archive as module
from e4dgs.workflows.storage.archive import unpacked


def zipped(file, entries, system=0, flags=0):
    """entries: names as bytes, so that any encoding can be written."""
    with zipfile.ZipFile(file, "w") as archive:
        for i, (name, content) in enumerate(entries.items()):
            info = zipfile.ZipInfo(f"{f'{i};':~>{len(name)}}")
            info.create_system = system
            archive.writestr(info, content)
    data = file.read_bytes()
    for i, name in enumerate(entries):
        data = data.replace(f"{f'{i};':~>{len(name)}}".encode(), name)
    file.write_bytes(data)
    return file


def shown(root):
    return sorted(path.relative_to(root).as_posix() for path in root.rglob("*") if path.is_file())


def test_names_with_backslashes_are_folders(colmap_capture, tmp_path):
    """As Compress-Archive of Windows PowerShell 5 and old .NET write them."""
    paths = [path for path in sorted(colmap_capture.root.rglob("*")) if path.is_file()]
    names = [str(path.relative_to(colmap_capture.root)).replace("/", "\\").encode() for path in paths]
    entries = dict(zip(names, (path.read_bytes() for path in paths), strict=True))
    root = unpacked(zipped(tmp_path / "band.zip", {b"images\\": b"", **entries}), tmp_path / "work")
    capture, plain = recognise(root), recognise(colmap_capture.root)
    assert capture.facts == plain.facts and capture.names == plain.names and capture.facts["format"] == "colmap"


def test_a_backslash_in_a_name_of_unix_is_part_of_it(tmp_path):
    file = zipped(tmp_path / "a.zip", {b"in/a\\b.txt": b"x", b"in/c.txt": b"x"}, system=3)
    assert shown(unpacked(file, tmp_path / "work")) == ["a\\b.txt", "c.txt"]


@pytest.mark.parametrize("name", [b"..\\out.png", b"a\\..\\..\\out.png", b"C:\\out.png", b"\\\\server\\out.png", b"\\out.png"])
@pytest.mark.parametrize("system", [0, 3])
def test_nothing_leaves_the_folder_by_a_backslash(tmp_path, name, system):
    with pytest.raises(CaptureError, match="leads out"):
        unpacked(zipped(tmp_path / "bad.zip", {b"fine.png": b"", name: b"x"}, system), tmp_path / "work")


@pytest.mark.parametrize(
    ("raw", "name"),
    [
        ("café_000.png".encode(), "café_000.png"),
        (unicodedata.normalize("NFD", "café_000.png").encode(), unicodedata.normalize("NFD", "café_000.png")),
        ("café_000.png".encode("cp437"), "café_000.png"),
        ("présence.png".encode("cp437"), "présence.png"),
        ("写真_000.png".encode("cp932"), "写真_000.png"),
        ("ソース.png".encode("cp932"), "ソース.png"),
        (b"\xff\xfe\xfd.png", "\xa0\u25a0\xb2.png"),
    ],
)
def test_names_without_the_flag_of_utf8(tmp_path, raw, name):
    """macOS writes UTF-8 without saying so, Windows the code page of its language: also one whose second bytes are backslashes."""
    assert shown(unpacked(zipped(tmp_path / "a.zip", {raw: b"x", b"b.png": b"x"}), tmp_path / "work")) == sorted([name, "b.png"])


@pytest.mark.parametrize("name", ["room.tar", "room.tar.gz", "room.tgz", "room.tar.bz2", "room.tar.xz", "room.TGZ", "room"])
def test_tars_are_read(colmap_capture, tmp_path, name):
    way = {"gz": "gz", "tgz": "gz", "bz2": "bz2", "xz": "xz"}.get(name.lower().rsplit(".", 1)[-1], "")
    with tarfile.open(tmp_path / name, f"w:{way}") as archive:
        archive.add(colmap_capture.root, ".")
    root = unpacked(tmp_path / name, tmp_path / "work")
    assert root.name == "room" and recognise(root).facts == recognise(colmap_capture.root).facts


def tar(file, members, content=b"x", mode="w"):
    with tarfile.open(file, mode) as archive:
        for name, kind, target in members:
            info = tarfile.TarInfo(name)
            info.type, info.linkname, info.size = kind, target, len(content) if kind == tarfile.REGTYPE else 0
            archive.addfile(info, io.BytesIO(content) if kind == tarfile.REGTYPE else None)
    return file


@pytest.mark.parametrize(
    ("name", "kind", "target", "says"),
    [
        ("../out.png", tarfile.REGTYPE, "", "leads out"),
        ("/tmp/out.png", tarfile.REGTYPE, "", "leads out"),
        ("a\nb.png", tarfile.REGTYPE, "", "is not a file name"),
        ("a/" * 90 + "b.png", tarfile.REGTYPE, "", "is not a file name"),
        ("link.png", tarfile.SYMTYPE, "/etc/hostname", "is a link"),
        ("link.png", tarfile.LNKTYPE, "fine.png", "is a link"),
        ("pipe.png", tarfile.FIFOTYPE, "", "neither a file nor a folder"),
        ("disk.png", tarfile.BLKTYPE, "", "neither a file nor a folder"),
        ("fine.png", tarfile.REGTYPE, "", "is in it twice"),
    ],
)
def test_tars_that_do_harm_are_refused(tmp_path, name, kind, target, says):
    file = tar(tmp_path / "bad.tar", [("fine.png", tarfile.REGTYPE, ""), (name, kind, target)])
    with pytest.raises(CaptureError, match=says):
        unpacked(file, tmp_path / "work")
    assert not list((tmp_path / "work/unpacked").iterdir())
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bad.tar", "work"]


def test_tar_bombs_and_damage(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "SLACK", 0)
    bomb = tar(tmp_path / "bomb.tar.gz", [("zeros", tarfile.REGTYPE, "")], bytes(3_000_000), "w:gz")
    with pytest.raises(CaptureError, match="too many for a capture"):
        unpacked(bomb, tmp_path / "work")
    whole = tar(tmp_path / "a.tar", [("a", tarfile.REGTYPE, "")], bytes(3_000)).read_bytes()
    two = tar(tmp_path / "b.tar", [("a", tarfile.REGTYPE, ""), ("b", tarfile.REGTYPE, "")]).read_bytes()
    (tmp_path / "cut.tar").write_bytes(whole[:2000])
    (tmp_path / "half.tar").write_bytes(two[:1200])  # within the header of the second file
    (tmp_path / "damaged.tar").write_bytes(two[:1100] + b"\xff" * 10 + two[1110:])
    small = tar(tmp_path / "small.tgz", [("a", tarfile.REGTYPE, "")], b"words", "w:gz").read_bytes()
    (tmp_path / "cut.tgz").write_bytes(small[:-6])
    for name in ("cut.tar", "half.tar", "damaged.tar", "cut.tgz"):
        with pytest.raises(CaptureError, match="cannot be unpacked"):
            unpacked(tmp_path / name, tmp_path / "work")
    header = bytearray(whole[:512])
    header[156:157], header[124:136] = b"x", b"%011o\0" % 2**32  # an extended header of 4 GiB
    header[148:156] = b"%06o\0 " % (sum(header[:148]) + 8 * 32 + sum(header[156:]))
    (tmp_path / "long.tar").write_bytes(bytes(header) + whole)
    with pytest.raises(CaptureError, match="a header of 4294967296 bytes"):
        unpacked(tmp_path / "long.tar", tmp_path / "work")


@pytest.mark.parametrize(
    ("begin", "kind"), [(b"7z\xbc\xaf\x27\x1c", "7z"), (b"Rar!\x1a\x07\x01\0", "RAR"), (b"\x28\xb5\x2f\xfd", "Zstandard")]
)
@pytest.mark.parametrize("name", ["room.7z", "room.zip", "room"])
def test_other_archives_are_named(tmp_path, begin, kind, name):
    (tmp_path / name).write_bytes(begin + bytes(100))
    for read in (lambda path: unpacked(path, tmp_path / "work"), recognise):
        with pytest.raises(CaptureError, match=rf"{name}: .*{kind}.*unpack it"):
            read(tmp_path / name)


def test_what_is_named_like_an_archive_and_is_none(tmp_path):
    for name in ("a.zip", "b.tar.gz", "c.7z"):
        (tmp_path / name).write_bytes(b"text")
        with pytest.raises(CaptureError, match="begins like none"):
            unpacked(tmp_path / name, tmp_path / "work")
    clip = Path(tmp_path / "clip.mp4")
    clip.write_bytes(b"\0\0\0\x18ftypmp42")
    assert unpacked(clip, tmp_path / "work") == clip
