"""COLMAP models as people's tools write them: text with and without lines of keypoints, several models, models in other places."""

import re
import shutil

import numpy as np
import pytest
from e4dgs.pipeline import CaptureError
from e4dgs.stages.captures import recognise
from e4dgs.stages.captures.formats.colmap_model import binary, cloud
from factory import Options, make, write_colmap, write_nerfstudio
from PIL import Image

PATH = Options(backdrop="room", rig="path", times=12, width=40, height=32, samples=1, fov_degrees=60.0)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    return write_colmap(make(PATH), tmp_path_factory.mktemp("colmap"))


@pytest.fixture
def root(written, tmp_path):
    return shutil.copytree(written.root, tmp_path / "capture")


def assert_truth(capture, written, count=12):
    views = dict(zip(written.files, written.views, strict=True))
    assert len(capture.names) == count
    for name, pose, K in zip(capture.names, capture.cam_from_world, capture.K, strict=True):
        view = views["images/" + name.rsplit("/", 1)[-1]]
        np.testing.assert_allclose(pose, view.camera.cam_from_world, atol=1e-9)
        np.testing.assert_allclose(K, view.camera.K, atol=1e-9)


def rewrite(root, change, file="images.txt"):
    """`change` gets the lines that are not empty."""
    path = root / "sparse/0" / file
    lines = [line for line in path.read_text().splitlines() if line]
    path.write_text(change(lines))


TEXTS = {
    "empty lines before each image": lambda rows: "# head\n\n\n" + "\n".join(f"{row}\n\n# next\n" for row in rows),
    "comments between an image and its keypoints": lambda rows: "\n".join(f"{row}\n# 0 keypoints\n" for row in rows),
    "keypoints": lambda rows: "\n".join(f"{row}\n1.5 2.5 -1 3.25 4.0 17" for row in rows) + "\n",
    "many keypoints": lambda rows: "\n".join(f"{row}\n" + "10.25 20.5 -1 " * 9000 for row in rows) + "\n",
    "no last line": lambda rows: "\n\n".join(rows),
    "tabs and blanks": lambda rows: "\n\n".join("  " + row.replace(" ", "\t") + "  " for row in rows) + "\n\n",
    "CR LF": lambda rows: "\r\n\r\n".join(rows) + "\r\n\r\n",
}


@pytest.mark.parametrize("case", TEXTS)
def test_text_is_read_as_colmap_reads_it(root, written, case):
    rewrite(root, TEXTS[case])
    capture = recognise(root, fps=30)
    assert_truth(capture, written)
    assert not capture.notes


def test_byte_order_marks(root, written):
    for file in (root / "sparse/0").glob("*.txt"):
        file.write_bytes(b"\xef\xbb\xbf" + file.read_bytes().replace(b"\n", b"\r\n"))
    capture = recognise(root, fps=30)
    assert_truth(capture, written)
    assert len(capture.points) > 100 and not capture.notes


def test_images_without_lines_of_keypoints_are_all_read_if_no_line_can_be_another_thing(root, written):
    rewrite(root, lambda rows: "# by hand\n" + "\n".join(rows) + "\n")
    capture = recognise(root, fps=30)
    assert_truth(capture, written)
    (note,) = capture.notes
    assert "images.txt has no lines of keypoints" in note and "12 lines" in note


@pytest.mark.parametrize("doubt", ["a picture is missing", "keypoints elsewhere", "no numbers"])
def test_a_line_that_is_no_list_of_keypoints_is_named(root, doubt):
    def change(rows):
        below = {"keypoints elsewhere": {5: "1.0 2.0 -1"}, "no numbers": {0: "1.0 2.0 here"}}.get(doubt, {})
        blank = {0} if doubt == "keypoints elsewhere" else set()
        return (
            "\n".join(line for i, row in enumerate(rows) for line in (row, *([below[i]] if i in below else [""] if i in blank else [])))
            + "\n"
        )

    rewrite(root, change)
    if doubt == "a picture is missing":
        (root / "images/007.png").unlink()
    with pytest.raises(CaptureError) as caught:
        recognise(root)
    line = {"a picture is missing": 2, "keypoints elsewhere": 4, "no numbers": 2}[doubt]
    assert f"sparse/0/images.txt: line {line} should list keypoints or be empty; found" in str(caught.value)


def test_bad_lines_are_named(root):
    rewrite(root, lambda rows: "\n\n".join(rows[:3]) + "\n\n" + " ".join(rows[3].split()[:6]) + "\n")
    with pytest.raises(CaptureError, match=r"sparse/0/images\.txt: .*line 7 has 6 words"):
        recognise(root)
    rewrite(root, lambda rows: "1 PINHOLE 40 x 1 1 1 1\n", "cameras.txt")
    with pytest.raises(CaptureError, match=r"sparse/0/cameras\.txt: .*line 1: 'x' is not a number"):
        recognise(root)


def part(root, folder, keep, points=True):
    """Writes the images of a model for which `keep(i)` into another folder."""
    shutil.copytree(root / "sparse/0", root / folder, dirs_exist_ok=True)
    rows = [line for line in (root / "sparse/0/images.txt").read_text().splitlines() if line]
    (root / folder / "images.txt").write_text("\n\n".join(row for i, row in enumerate(rows) if keep(i)) + "\n\n")


@pytest.mark.parametrize(
    "other", ["sparse/1", "sparse/12", "colmap/sparse/0", "dense/sparse", "distorted/sparse/0", "sparse_", "dense/0/sparse"]
)
def test_the_model_with_most_images_is_read_and_the_others_are_named(root, written, other):
    part(root, other, lambda i: i > 2)
    rewrite(root, lambda rows: "\n\n".join(rows[:3]) + "\n\n")
    capture = recognise(root)
    assert_truth(capture, written, 9)
    assert any(f"{other} with 9 images is read" in note and "sparse/0 has 3" in note for note in capture.notes)
    assert any(f"3 images without a pose in {other} are left out" in note for note in capture.notes)
    assert {"sparse/0/images.txt", f"{other}/images.txt"} <= set(capture.files)


def test_of_equal_models_the_first_is_read(root):
    part(root, "sparse/1", lambda i: True)
    assert any("sparse/0 with 12 images is read" in note and "sparse/1 has 12" in note for note in recognise(root).notes)


def test_a_damaged_model_does_not_stop_the_others(root, written):
    part(root, "sparse/1", lambda i: True)
    (root / "sparse/0/images.txt").write_text("1 2 3\n")
    capture = recognise(root)
    assert_truth(capture, written)
    assert any("sparse/0 is not read, since it is damaged" in note for note in capture.notes)


@pytest.mark.parametrize(
    "place", ["colmap/sparse/0", "colmap_sparse", "colmap_sparse/0", "sparse/1", "dense/sparse", "distorted/sparse/0", "sparse_", "."]
)
def test_a_model_elsewhere_is_found(root, written, place):
    (root / "sparse/0").rename(root / "moved")
    (root / "sparse").rmdir()
    (root / place).mkdir(parents=True, exist_ok=True)
    for file in (root / "moved").iterdir():
        file.rename(root / place / file.name)
    (root / "moved").rmdir()
    capture = recognise(root)
    assert capture.facts["format"] == "colmap"
    assert_truth(capture, written)


def test_pictures_may_lie_beside_the_model(root, written):
    for file in (root / "images").iterdir():
        file.rename(root / file.name)
    (root / "images").rmdir()
    assert_truth(recognise(root), written)


def test_dense_models_go_with_dense_images(root, written):
    """The undistorted pictures are larger than those that were taken."""
    shutil.copytree(root / "images", root / "dense/images")
    part(root, "dense/sparse", lambda i: True)
    shutil.rmtree(root / "sparse")
    for file in (root / "images").iterdir():
        Image.open(file).resize((44, 36)).save(file)
    capture = recognise(root)
    assert capture.images[0].startswith("dense/images/")
    assert_truth(capture, written)


def test_the_model_of_the_distorted_pictures_is_not_that_of_the_undistorted(root, written):
    """As 3D Gaussian splatting's convert.py leaves them: distorted/ has more images, but of other sizes."""
    part(root, "distorted/sparse/0", lambda i: True)
    (root / "distorted/sparse/0/cameras.txt").write_text("1 SIMPLE_RADIAL 38 30 30 19 15 0.1\n")
    rewrite(root, lambda rows: "\n\n".join(rows[:10]) + "\n\n")
    capture = recognise(root)
    assert "a COLMAP model in sparse/0" in capture.facts["why"]
    assert_truth(capture, written, 10)


def test_a_model_of_which_transforms_json_was_made_is_named_alone(tmp_path):
    written = write_nerfstudio(make(PATH), tmp_path)
    other = write_colmap(make(PATH), tmp_path / "other")
    shutil.copytree(other.root / "sparse/0", tmp_path / "colmap/sparse/0")
    shutil.rmtree(tmp_path / "other")
    capture = recognise(written.root)
    assert capture.facts["format"] == "nerfstudio"
    assert any("the COLMAP model in colmap/sparse/0 is not read, because the layout is nerfstudio" in n for n in capture.notes)


def test_deleted_pictures_are_left_out_and_counted(root, written):
    (root / "images/004.png").unlink()
    (root / "masks").mkdir()
    Image.new("L", (40, 32), 255).save(root / "masks/004.png")  # has its name, and must not take its place
    for name in ("masks/003.png", "masks/005.png"):
        Image.new("L", (40, 32), 255).save(root / name)
    capture = recognise(root)
    assert_truth(capture, written, 11)
    assert any("1 of 12 images of sparse/0/images.txt have no image and are left out" in n and "004.png" in n for n in capture.notes)
    for i in range(5, 11):
        (root / f"images/{i:03d}.png").unlink()
    with pytest.raises(CaptureError, match=r"004\.png.*7 of 12 images"):
        recognise(root)


def test_smaller_copies_are_named(root):
    shutil.copytree(root / "images", root / "images_4")
    assert any("images_4" in note and "not read" in note for note in recognise(root).notes)


@pytest.mark.parametrize("folder", ["photos", "images_4", "rgb"])
def test_pictures_may_lie_in_a_folder_of_another_name(root, written, folder):
    (root / "images").rename(root / folder)
    (root / "masks").mkdir()
    capture = recognise(root)
    assert capture.images[0].startswith(f"{folder}/")
    assert_truth(capture, written)


def as_both(root):
    """The text model of `root` as binary, beside the text."""
    pycolmap = pytest.importorskip("pycolmap")
    pycolmap.Reconstruction(str(root / "sparse/0")).write_binary(str(root / "sparse/0"))
    return root


def twice_told(root):
    return [note for note in recognise(root).notes if "as .txt" in note]


def test_a_model_as_binary_and_as_text_that_agree_is_read_in_silence(root, written):
    assert_truth(recognise(as_both(root)), written)
    assert twice_told(root) == []


TWICE = {
    "pose": ("images.txt", lambda row: _moved(row), "the poses of image '000.png' differ"),
    "camera": ("cameras.txt", lambda row: " ".join([*row.split()[:4], "99", *row.split()[5:]]), "the cameras of image '000.png' differ"),
    "name": ("images.txt", lambda row: row.replace("000.png", "zzz.png"), "12 images and 12; only one of them has '000.png'"),
    "damage": ("images.txt", lambda row: row.replace(" ", " x", 1), "is damaged: sparse/0/images.txt"),
}


def _moved(row):
    words = row.split()
    return " ".join([*words[:5], str(float(words[5]) + 0.1), *words[6:]])


@pytest.mark.parametrize("case", TWICE)
def test_a_model_as_binary_and_as_text_that_disagree_is_told(root, written, case):
    file, change, words = TWICE[case]
    path = as_both(root) / "sparse/0" / file
    first, *rest = path.read_text().split("\n")
    path.write_text("\n".join([change(first), *rest]))
    assert_truth(recognise(root), written)  # the binary one
    (line,) = twice_told(root)
    assert line.startswith("sparse/0 has its model as .bin, which is read, and as .txt, which is not") and words in line


def renamed(root, stem, page, suffix):
    """Pictures with names of other letters than ASCII, and a model with these names in a code page of Windows."""
    for file in (root / "images").iterdir():
        file.rename(file.with_name(f"{stem}{file.name}"))
    place = root / "sparse/0/images.txt"
    rows = [re.sub(r" (\d+\.png)$", rf" {stem}\1", row) for row in place.read_text().splitlines() if row]
    place.write_text("".join(f"{row}\n\n" for row in rows), page)
    if suffix == ".bin":
        as_both(root)
        for part in ("cameras", "images"):
            (root / f"sparse/0/{part}.txt").unlink()


@pytest.mark.parametrize("suffix", [".txt", ".bin"])
@pytest.mark.parametrize(("page", "stem"), [("cp936", "照片_"), ("cp932", "ソ写真_"), ("cp1252", "Küche_")])
def test_names_in_a_code_page_are_read_if_pictures_have_them(root, written, suffix, page, stem):
    renamed(root, stem, page, suffix)
    capture = recognise(root, fps=30)
    views = dict(zip(written.files, written.views, strict=True))
    assert len(capture.names) == 12
    for name, pose in zip(capture.names, capture.cam_from_world, strict=True):
        np.testing.assert_allclose(pose, views[name.replace(stem, "")].camera.cam_from_world, atol=1e-9)
    (note,) = capture.notes
    assert f"images{suffix} has names that are not UTF-8: they are read in code page {page}" in note


@pytest.mark.parametrize("suffix", [".txt", ".bin"])
def test_names_that_are_no_utf_8_and_no_pictures_are_told_as_that(root, suffix):
    renamed(root, "照片_", "cp936", suffix)
    for file in (root / "images").iterdir():
        file.rename(file.with_name(file.name.replace("照片_", "x")))
    with pytest.raises(
        CaptureError, match=r"images.* the names of 12 of 12 images .first b'\\xd5\\xd5.*neither UTF-8 nor.*make the model again"
    ):
        recognise(root)


def test_images_without_lines_of_keypoints_may_have_names_in_a_code_page(root):
    renamed(root, "照片_", "cp936", ".txt")
    rewritten = (root / "sparse/0/images.txt").read_bytes().replace(b"\n\n", b"\n")
    (root / "sparse/0/images.txt").write_bytes(rewritten)
    (note,) = recognise(root, fps=30).notes
    assert "code page cp936" in note and "no lines of keypoints" in note


def test_a_model_in_utf_16_is_told_as_that(root):
    place = root / "sparse/0/images.txt"
    place.write_text(place.read_text(), "utf-16")
    with pytest.raises(CaptureError, match=r"images.txt: .*it is UTF-16; save it as UTF-8"):
        recognise(root)


@pytest.mark.parametrize("suffix", [".txt", ".bin"])
def test_too_many_points_are_no_damage(root, monkeypatch, suffix):
    """To export the model again would give as many."""
    count = len([row for row in (root / "sparse/0/points3D.txt").read_text().splitlines() if row and not row.startswith("#")])
    if suffix == ".bin":
        as_both(root)
        for file in (root / "sparse/0").glob("*.txt"):
            file.unlink()
    for module in (cloud, binary):
        monkeypatch.setattr(module, "MOST_POINTS", count)
    assert len(recognise(root).points) == count
    for module in (cloud, binary):
        monkeypatch.setattr(module, "MOST_POINTS", count - 1)
    with pytest.raises(
        CaptureError, match=rf"points3D\{suffix}: it has (more than )?\d+ points, and at most {count - 1} are read; thin"
    ) as e:
        recognise(root)
    assert "cut short" not in str(e.value) and "export" not in str(e.value)
    (root / f"sparse/0/points3D{suffix}").unlink()  # as the message says
    assert recognise(root).points is None


def ply(path, points, ending=""):
    rows = "".join(f"{x} {y} {z} 10 20 30\n" for x, y, z in points)
    names = "".join(f"property float {axis}\n" for axis in "xyz") + "".join(f"property uchar {c}\n" for c in ("red", "green", "blue"))
    path.write_text(f"ply\nformat ascii 1.0\nelement vertex {len(points)}{ending}\n{names}end_header\n{rows}")
    return path.relative_to(path.parents[2]).as_posix()


def test_points_may_lie_in_a_ply_file_alone(root, written):
    """As programs for Gaussian splatting keep them, which write it at their first run and read no other file then."""
    (root / "sparse/0/points3D.txt").unlink()
    file = ply(root / "sparse/0/points3D.ply", np.arange(1500).reshape(-1, 3) / 100)
    capture = recognise(root, fps=30)
    assert_truth(capture, written)
    assert file in capture.files and not capture.notes
    np.testing.assert_allclose(capture.points, np.arange(1500).reshape(-1, 3) / 100)
    assert (capture.point_colors == (10, 20, 30)).all()
    ply(root / "sparse/0/points3D.ply", [], ending="x")
    with pytest.raises(CaptureError, match=r"sparse/0/points3D\.ply: element vertex has no count"):
        recognise(root, fps=30)


@pytest.mark.parametrize("more", [0, 300, -50])
def test_a_ply_file_with_another_number_of_points_is_read_and_told(root, more):
    own = recognise(root, fps=30).points
    assert len(own) > 100
    file = ply(root / "sparse/0/points3D.ply", np.ones((len(own) + more, 3)))
    capture = recognise(root, fps=30)
    assert file in capture.files and "sparse/0/points3D.txt" in capture.files
    if more == 0:
        np.testing.assert_array_equal(capture.points, own)
        assert not capture.notes
        return
    assert (capture.points == 1).all() and len(capture.points) == len(own) + more
    (note,) = capture.notes
    assert (
        note.startswith(f"the {len(own) + more} points of {file} are read, as") and f"not the {len(own)} of sparse/0/points3D.txt" in note
    )


def test_a_damaged_ply_file_leaves_the_points_of_the_model(root):
    own = recognise(root, fps=30).points
    ply(root / "sparse/0/points3D.ply", np.ones((3, 3)), ending="0")
    capture = recognise(root, fps=30)
    np.testing.assert_array_equal(capture.points, own)
    (note,) = capture.notes
    assert (
        note.startswith("the points of sparse/0/points3D.txt are read, and not those of sparse/0/points3D.ply: ") and "30 vertices" in note
    )


def test_points_may_be_text_beside_a_binary_model(root, written):
    own = recognise(root).points
    as_both(root)
    for name in ("points3D.bin", "images.txt", "cameras.txt"):
        (root / "sparse/0" / name).unlink()
    capture = recognise(root)
    assert_truth(capture, written)
    np.testing.assert_array_equal(capture.points, own)
    assert "sparse/0/points3D.txt" in capture.files
