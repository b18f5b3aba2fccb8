"""Nothing is ignored in silence: a line for each known kind of file that the result does not depend on."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from e4dgs.pipeline import CaptureError
from e4dgs.stages.captures import recognise
from e4dgs.stages.captures.listing import tree as walking
from e4dgs.stages.captures.listing.kinds import DYNAMIC, PICTURE, POSE, VIDEO, colour_only, kind_of
from e4dgs.stages.captures.listing.unread import MASK_PLACES, unread
from PIL import Image
from tiny_videos import encode, levels


def pictures(root, names, size=(16, 12)):
    for i, name in enumerate(names):
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.new("RGB", size, (i, 0, 0)).save(path, format="PNG" if path.suffix.lower() == ".png" else "JPEG")
    return root


def stubs(root, *names):
    for name in names:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_bytes(b"x")
    return root


def lines(root, **options):
    return [note for note in recognise(root, **options).notes if "not read" in note or "ignored" in note]


def photos(tmp_path, *others, count=4):
    return stubs(pictures(tmp_path / "photos", [f"IMG_{i}.JPG" for i in range(count)]), *others)


def test_all_that_is_read_is_not_spoken_of(
    dnerf_capture, n3v_capture, panoptic_capture, nerfstudio_capture, colmap_capture, images_capture, videos_capture
):
    for capture in (
        *(dnerf_capture, n3v_capture, panoptic_capture, nerfstudio_capture),
        *(colmap_capture, images_capture, videos_capture),
    ):
        assert lines(capture.root) == []


CLOSED = {
    "HEIC": (("a.HEIC", "b.heic", "c.heif", "d.hif"), "4 HEIC pictures (first a.HEIC) are not read; convert them to JPEG"),
    "AVIF": (("a.avif",), "the AVIF picture a.avif is not read; convert it to JPEG"),
    "JXL": (("a.jxl", "b.JXL"), "2 JPEG XL pictures (first a.jxl) are not read; convert them to JPEG"),
    "JP2": (("a.jp2",), "the JPEG 2000 picture a.jp2 is not read; convert it to JPEG"),
    "DNG": (("a.dng", "b.DNG"), "2 DNG (camera raw) pictures (first a.dng) are not read; develop them to JPEG or to TIFF of 16 bits"),
    "NEF": (("a.NEF",), "the NEF (camera raw) picture a.NEF is not read; develop it"),
    "CR3": (("a.CR3", "a2.cr2"), "the CR3 (camera raw) picture a.CR3 is not read; develop it"),
    "EXR": (("a.exr",), "the EXR picture a.exr is not read; convert it to PNG"),
    "linear light": (
        ("a.exr", "b.exr"),
        "2 EXR pictures (first a.exr) are not read; convert them to PNG coded as sRGB, since the numbers stand for linear light, for "
        "example with oiiotool IN --colorconvert linear sRGB -d uint8 -o OUT.png",
    ),
    "DPX": (("a.1001.dpx", "a.1002.dpx"), "2 DPX pictures (first a.1001.dpx) are not read; convert them to PNG coded as sRGB, since"),
    "Cineon": (("a.cin",), "the Cineon picture a.cin is not read; convert it to PNG coded as sRGB, since the numbers stand for log or"),
    "SGI": (("a.sgi", "b.rgb"), "2 SGI pictures (first a.sgi) are not read; convert them to PNG"),
    "PCX": (("a.pcx",), "the PCX picture a.pcx is not read; convert it to PNG"),
    "QOI": (("a.qoi",), "the QOI picture a.qoi is not read; convert it to PNG"),
    "JXR": (("a.jxr",), "the JPEG XR picture a.jxr is not read; convert it to JPEG"),
    "INSV": (("a.insv",), "the INSV video a.insv is not read; export it as MP4"),
    "LRV": (
        ("GL010034.LRV",),
        "the low-resolution copy of a video GL010034.LRV is not read; pass the video in full resolution, or rename it",
    ),
    "THM": (("MVI_1.THM", "MVI_2.thm"), "2 thumbnails (first MVI_1.THM) are not read"),
    "videos": (("a/b.MTS", "a/c.3gp", "a/d.mp4"), "3 videos (first a/b.MTS) are not read, because the layout is images"),
    "poses": (("sub/poses_bounds.npy",), "sub/poses_bounds.npy is not read, because the layout is images"),
    "LLFF of several views": (
        ("poses_bounds_multipleview.npy",),
        "poses_bounds_multipleview.npy is not read, because the layout is images",
    ),
    "transforms": (
        ("transforms_old.json", "sub/transforms.json"),
        "sub/transforms.json and transforms_old.json are not read, because the layout is images",
    ),
    "a pose a picture": (
        [f"frame-{i:06d}.pose.txt" for i in range(5)],
        "5 pose files (first frame-000000.pose.txt) are not read, because the layout is images",
    ),
    "cameras of Metashape": (("cameras.xml",), "cameras.xml is not read, because the layout is images"),
    "immersive light fields": (("models.json",), "models.json is not read, because the layout is images"),
    "Record3D": (("metadata.json",), "metadata.json is not read, because the layout is images"),
    "Bundler": (("bundle.out",), "bundle.out is not read, because the layout is images"),
    "VisualSFM": (("model.nvm",), "model.nvm is not read, because the layout is images"),
    "camera of Nuke": (
        ("shot.chan",),
        "the pose file of another program shot.chan is not read; export the poses as a COLMAP model or transforms.json, with",
    ),
    "matchmove": (("shot.abc",), "the pose file of another program shot.abc is not read; export the poses as a COLMAP model"),
    "angles": (("scene_opk.txt",), "the pose file of another program scene_opk.txt is not read; export the poses"),
    "ContextCapture": (("a_blocks_exchange.xml", "BlocksExchange.xml"), "2 pose files of other programs (first "),
    "RealityCapture": (("room.rcproj",), "the pose file of another program room.rcproj is not read; export the poses"),
    "Pix4D": (
        ("x_calibrated_external_camera_parameters.txt",),
        "the pose file of another program x_calibrated_external_camera_parameters.txt is not read; export the poses",
    ),
    "a trajectory": (("traj.txt",), "traj.txt is not read, because the layout is images"),
    "MVSNet": (("cams/00000000_cam.txt", "cams/00000001_cam.txt"), "2 pose files (first cams/00000000_cam.txt) are not read"),
    "EasyMocap": (("intri.yml", "extri.yml"), "extri.yml and intri.yml are not read, because the layout is images"),
    "others of data sets": (("a.traj", "annots.npy", "X_COLMAP_SfM.log"), "X_COLMAP_SfM.log, a.traj and annots.npy are not read"),
    "light field": (("a.lfr",), "the LFR picture a.lfr is not read; export it as JPEG"),
    "model": (
        ("colmap/sparse/0/cameras.bin", "colmap/sparse/0/images.bin", "colmap/sparse/0/points3D.bin", "colmap/sparse/0/project.ini"),
        "the COLMAP model in colmap/sparse/0 is not read, because the layout is images",
    ),
    "models and others": (
        ("sparse/1/cameras.txt", "sparse/1/images.txt", "sparse_/cameras.bin", "sparse_/images.bin", "transforms_a.json"),
        "the COLMAP model in sparse/1, the COLMAP model in sparse_ and transforms_a.json are not read, because the layout is images",
    ),
    "database": (("database.db",), "the COLMAP database database.db is not read, because the layout is images"),
    "another database": (("rtabmap.db",), "the database rtabmap.db is not read, because the layout is images"),
    "lists": (("train_list.txt", "rgb.txt"), "2 lists of files or times (first rgb.txt) are not read, because the layout is images"),
    "tracks": (("DJI_1.SRT", "a.gpx", "imu.csv"), "3 subtitles or tracks (first DJI_1.SRT) are not read, because the layout is images"),
    "clouds": (("a.ply", "b.las", "c.pcd"), "3 point clouds (first a.ply) are not read, because the layout is images"),
    "archives": (("a.zip", "b.7z"), "2 archives (first a.zip) are not read; unpack them, or pass such a file as the capture"),
    "depth arrays": (
        ("depth/0.npy", "depth/1.npy"),
        "2 depth maps (first depth/0.npy) are not read, because depth is read by the name of its picture: that of IMG_0.JPG",
    ),
    "calibration": (("intrinsics.json",), "the calibration file intrinsics.json is not read, because the layout is images"),
}


@pytest.mark.parametrize("case", CLOSED)
def test_a_line_for_each_kind(tmp_path, case):
    names, line = CLOSED[case]
    found = lines(photos(tmp_path, *names))
    assert any(note.startswith(line) for note in found), found
    assert len(found) == (2 if case == "CR3" else 1), found


@pytest.mark.parametrize("suffix", ["dpx", "cin", "sgi", "rgb", "pcx", "qoi", "jxr", "exr", "hdr"])
def test_a_sequence_of_a_closed_kind_is_named(tmp_path, suffix):
    """The whole sequence and one file of it; neither is a video that was cut short."""
    root = stubs(tmp_path / "plates", *(f"plate.{1001 + i}.{suffix}" for i in range(5)))
    for path in (root, root / f"plate.1001.{suffix}"):
        with pytest.raises(CaptureError, match=r"convert them to (PNG|JPEG)") as refusal:
            recognise(path)
        assert "video" not in str(refusal.value) and "cut short" not in str(refusal.value)


REALITY_CAPTURE = '<x:xmpmeta xmlns:x="adobe:ns:meta/"><xcr:Rotation>1 0 0 0 1 0 0 0 1</xcr:Rotation></x:xmpmeta>'
LIGHTROOM = '<x:xmpmeta xmlns:x="adobe:ns:meta/"><crs:Exposure2012>+0.50</crs:Exposure2012></x:xmpmeta>'
SCANNER_APP = '{"cameraPoseARFrame": [1, 0, 0, 0], "frame_index": 0}'


@pytest.mark.parametrize(("suffix", "content"), [("xmp", REALITY_CAPTURE), ("XMP", REALITY_CAPTURE), ("json", SCANNER_APP)])
def test_poses_beside_pictures_are_told_by_their_content(tmp_path, suffix, content):
    root = photos(tmp_path)
    for i in range(4):
        (root / f"IMG_{i}.{suffix}").write_text(content)
    (root / f"about.{suffix}").write_text(content)  # of no picture
    (line,) = lines(root)
    assert line.startswith(f"4 pose files of other programs (first IMG_0.{suffix}) are not read; export the poses as a COLMAP model or")


METASHAPE = '<?xml version="1.0" encoding="UTF-8"?>\n<document version="2.0.0">\n  <chunk label="Chunk 1" enabled="true">\n'


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("export.csv", "#name,x,y,alt,heading,pitch,roll\nIMG_0.jpg,0,0,1,0,0,0\n"),
        ("cameras.csv", "\ufeff#name;x;y;alt;heading;pitch;roll\n"),
        ("export.CSV", "#cameras 4\n#name,x,y,alt,yaw,pitch,roll,f,px,py\n"),
        ("reference.txt", "# CoordinateSystem: LOCAL_CS\n#Label,X/East,Y/North,Z/Altitude\n"),
        ("angles.txt", "# Cameras (4)\n# PhotoID, X, Y, Z, Omega, Phi, Kappa\n"),
        ("scan.xml", METASHAPE),
        ("cameras.xml", "\ufeff" + METASHAPE),
        ("block.xml", "<BlocksExchange version='3.2'>"),
    ],
)
def test_poses_of_photogrammetry_are_told_by_their_content(tmp_path, name, content):
    root = pictures(tmp_path / "shot", [f"images/{i}.jpg" for i in range(4)])
    (root / name).write_text(content, encoding="utf-8")
    told = f"the pose file of another program {name} is not read; export the poses as a COLMAP model or transforms.json"
    assert [line.startswith(told) for line in lines(root)] == [True]
    (line,) = lines(root / "images")
    assert told in line and line.startswith("beside the folder images/")


@pytest.mark.parametrize("content", ["name,age\n", "<svg><document/></svg>", "", "# name of the project\n"])
@pytest.mark.parametrize("name", ["about.csv", "about.xml", "about.txt"])
def test_tables_and_documents_of_other_things_are_no_poses(tmp_path, name, content):
    root = photos(tmp_path)
    (root / name).write_text(content)
    assert lines(root) == []


def test_settings_beside_pictures_are_no_poses(tmp_path):
    root = photos(tmp_path)
    (root / "IMG_0.xmp").write_text(LIGHTROOM)
    (root / "IMG_1.json").write_text('{"title": "IMG_1.JPG", "geoData": {"latitude": 0.0}}')
    assert lines(root) == []


def test_poses_of_other_programs_beside_poses_that_are_read(nerfstudio_capture, tmp_path):
    root = stubs(shutil.copytree(nerfstudio_capture.root, tmp_path / "n"), "shot.chan")
    assert lines(root) == ["the pose file of another program shot.chan is not read, because the layout is nerfstudio"]


def test_poses_of_other_programs_beside_the_folder_of_pictures(tmp_path):
    root = stubs(pictures(tmp_path / "shot", [f"images/{i}.jpg" for i in range(4)]), "shot.chan", "b.abc")
    for path in (root, root / "images"):
        (line,) = lines(path)
        assert "2 pose files of other programs (first b.abc) are not read; export the poses as a COLMAP model" in line


def test_files_that_say_nothing_of_a_capture(tmp_path):
    assert (
        lines(
            photos(
                tmp_path,
                "README.md",
                "notes.txt",
                "Thumbs.db2",
                "Thumbs.db",
                "ehthumbs_vista.db",
                "desktop.ini",
                ".DS_Store",
                ".hidden.heic",
                "__MACOSX/a.heic",
                "run.py",
                "LICENSE",
            )
        )
        == []
    )
    root = photos(tmp_path / "b", "work/store/x.ply", "work/scenes/a.png")
    assert lines(root) == [], "a workspace is no part of the capture"


def test_heic_beside_jpeg_of_the_same_photos(tmp_path):
    (line,) = lines(photos(tmp_path, "IMG_0.HEIC", "IMG_1.heic"))
    assert line == "2 HEIC pictures (first IMG_0.HEIC) are not read; each has the name of a picture that is read"


def test_pictures_that_were_left_out_on_purpose_are_said_once(images_capture, n3v_capture, tmp_path):
    assert lines(images_capture.root, every=3) == lines(images_capture.root, max_frames=4) == []
    np.save(tmp_path / "poses_bounds.npy", np.load(n3v_capture.root / "poses_bounds.npy"))
    pictures(tmp_path, [f"cam{c:02d}/{t}.png" for c in range(4) for t in range(4)], (80, 64))
    assert lines(tmp_path, every=2) == [] and lines(tmp_path) == []


def test_pictures_that_no_camera_uses(nerfstudio_capture, colmap_capture, tmp_path):
    root = shutil.copytree(nerfstudio_capture.root, tmp_path / "n")
    name = nerfstudio_capture.files[0]
    shutil.copy(root / name, root / "extra.png")
    assert lines(root) == ["the picture extra.png is not read, because no camera of the layout nerfstudio uses it"]
    other = shutil.copytree(colmap_capture.root, tmp_path / "c")
    shutil.copytree(other / "images", other / "images_4")
    stubs(other, "database.db", "poses_bounds.npy", "sparse/0/points3D.ply")
    assert lines(other) == [
        "images_4 holds the pictures of images/ in another size and is not read",
        "poses_bounds.npy is not read, because the layout is colmap",
        "the COLMAP database database.db is not read, because the layout is colmap",
    ]


def test_a_folder_images_whose_poses_lie_beside_it(colmap_capture, tmp_path):
    root = shutil.copytree(colmap_capture.root, tmp_path / "c")
    stubs(root, "poses_bounds.npy")
    assert lines(root / "images") == [
        "poses_bounds.npy and sparse/ beside the folder images/ are not read; give the folder that holds both"
    ]


def test_a_camera_matrix_beside_a_video_file_is_read_as_in_its_folder(video_capture, tmp_path):
    file = Path(shutil.copy(video_capture.root, tmp_path / "clip.mp4"))
    (tmp_path / "K.txt").write_text("30 0 10\n0 30 5\n0 0 1\n")
    for path in (file, tmp_path):
        capture = recognise(path)
        assert capture.K_hint == (30, 0, 10, 0, 30, 5, 0, 0, 1) and "K.txt" in capture.files and not lines(path)
    pictures(tmp_path, ["poster.png"])
    assert recognise(file).K_hint == recognise(tmp_path).K_hint is not None
    stubs(tmp_path, "poses.json", "sparse/0/cameras.bin")
    (line,) = lines(file)
    assert line.startswith("poses.json and sparse/ beside the video clip.mp4 are not read")


@pytest.mark.parametrize("other", ["second.mp4", "photos"])
def test_a_camera_matrix_that_may_be_of_others_than_a_video_file_is_told(video_capture, tmp_path, other):
    file = Path(shutil.copy(video_capture.root, tmp_path / "clip.mp4"))
    (tmp_path / "K.txt").write_text("30 0 10\n0 30 5\n0 0 1\n")
    if other == "photos":
        pictures(tmp_path, [f"{i}.jpg" for i in range(4)])
    else:
        shutil.copy(file, tmp_path / other)
    assert recognise(file).K_hint is None
    (line,) = lines(file)
    assert line.startswith("K.txt beside the video clip.mp4 is not read") and "no other video and no photos" in line


@pytest.mark.parametrize(
    ("colour", "other", "what"),
    [
        ("frame-{:06d}.color.png", "frame-{:06d}.depth.png", "depth maps"),
        ("rgb_{:03d}.png", "depth_{:03d}.png", "depth maps"),
        ("{:03d}.jpg", "{:03d}_depth.png", "depth maps"),
        ("r_{}.png", "r_{}_normal.png", "normal maps"),
        ("frame{:06d}.jpg", "depth{:06d}.png", "depth maps"),  # Replica
        ("frame_{:05d}.png", "mask_{:05d}.png", "masks"),
        ("rgba_{:05d}.png", "object_coordinates_{:05d}.png", "coordinate maps"),  # Kubric
        ("rgba_{:05d}.png", "forward_flow_{:05d}.png", "optical flow maps"),
        ("beauty_{:04d}.png", "mask_{:04d}.png", "masks"),
        ("frame_{:04d}.png", "enlarged_dynamic_mask_{}.png", "masks"),  # MonST3R
        ("{:05d}.png", "{:05d}_depth_vis.png", "depth maps"),
        ("images/{:03d}.png", "depth/{:03d}.png", "depth maps"),
        ("images/{:03d}.png", "normals/{:03d}.png", "normal maps"),
        ("images/{:03d}.png", "confidence/{:03d}.png", "confidence maps"),
    ],
)
def test_depth_among_colours(tmp_path, colour, other, what):
    root = pictures(tmp_path / "s", [name.format(i) for i in range(4) for name in (colour, other)])
    capture = recognise(root)
    assert capture.names == tuple(colour.format(i) for i in range(4))
    (note,) = [note for note in capture.notes if note.startswith(f"4 {what} (first {other.format(0)}) are not read")]
    if other.startswith(("depth/", "frame-")):
        assert "a picture of depth must have one channel of grey, not RGB" in note, "they are found by name"
    elif "depth" in other or "confidence" in other:
        assert "read by the name of its picture: that of " in note
    else:
        assert note.endswith(f", because the layout is images{f'; masks are read from {MASK_PLACES}' if what == 'masks' else ''}")


@pytest.mark.parametrize(("colour", "other"), [("DJI_1_000{}_V.JPG", "DJI_1_000{}_T.JPG"), ("a{}_RGB.jpg", "a{}_IR.jpg")])
def test_thermal_pictures_are_no_photos(tmp_path, colour, other):
    root = pictures(tmp_path / "s", [colour.format(i) for i in range(4)], (64, 48))
    pictures(root, [other.format(i) for i in range(4)])
    capture = recognise(root)
    assert capture.names == tuple(colour.format(i) for i in range(4)) and capture.facts["width"] == 64
    assert any(note.startswith(f"4 pictures of one band of light (first {other.format(0)}) are not read") for note in capture.notes)


def test_versions_of_photos_are_told_of_a_static_scene(tmp_path):
    root = pictures(tmp_path / "s", [f"{look}_{i}.png" for i in range(4) for look in ("warm", "cold")])
    (line,) = [note for note in recognise(root, static=True).notes if "the names hold" in note]
    assert line.endswith("if they are versions of one picture, keep one of each") and "camNN" not in line


def test_grey_of_16_bits_with_the_name_of_a_picture_is_its_depth(tmp_path):
    root = pictures(tmp_path / "s", [f"{i}.jpg" for i in range(4)])
    for i in range(3):
        Image.fromarray(np.full((12, 16), 1000, np.uint16)).save(root / f"{i}.png")
    capture = recognise(root, fps=30)
    assert capture.names == ("0.jpg", "1.jpg", "2.jpg", "3.jpg")
    assert capture.notes == (
        "3 pictures of 16 bits of grey with the name of another picture (first 0.png) are taken for its depth and are not read",
    )
    for i in range(4):
        Image.fromarray(np.full((12, 16), 1000, np.uint16)).save(root / f"{i}.jpg.png")
    alone = tmp_path / "grey"
    alone.mkdir()
    for i in range(3):
        Image.fromarray(np.full((12, 16), 1000, np.uint16)).save(alone / f"{i}.png")
    assert recognise(alone, fps=30).facts["frames"] == 3, "pictures of 16 bits of grey are pictures"


def test_every_picture_twice_is_a_question(tmp_path):
    root = pictures(tmp_path / "s", [f"{i}.{suffix}" for i in range(3) for suffix in ("jpg", "png")])
    with pytest.raises(CaptureError, match=r"every picture is there twice, with two suffixes \(first 0\.jpg and 0\.png\)"):
        recognise(root)
    (root / "1.png").unlink()
    assert any("2 pictures are there with two suffixes" in note for note in recognise(root).notes)


def test_folders_that_nothing_reads(tmp_path):
    heic = stubs(tmp_path / "heic", *(f"IMG_{i}.HEIC" for i in range(12)))
    with pytest.raises(
        CaptureError, match=r"12 HEIC pictures \(first IMG_0\.HEIC\) cannot be read: convert them to JPEG, for example with"
    ):
        recognise(heic)
    for kind in ("avif", "jp2", "NEF", "jxl", "insv"):
        with pytest.raises(CaptureError, match=rf"(?i){kind.replace('jp2', 'JPEG 2000').replace('jxl', 'JPEG XL')}.*cannot be read"):
            recognise(stubs(tmp_path / kind, f"a.{kind}", f"b.{kind}"))
    with pytest.raises(CaptureError, match=r"a\.heic.*one picture of a capture \(HEIC picture\).*convert them to JPEG"):
        recognise(stubs(tmp_path / "one", "a.heic") / "a.heic")
    one = stubs(pictures(tmp_path / "mixed", ["a.jpg"]), "b.heic", "c.heic")
    with pytest.raises(CaptureError, match=r"one image alone.*2 HEIC pictures \(first b\.heic\) cannot be read"):
        recognise(one)
    with pytest.raises(CaptureError, match=r"no images here; .*12 HEIC pictures"):
        recognise(heic, format="images")


def test_a_rig_without_poses_is_told_so(tmp_path):
    root = pictures(tmp_path / "rig", [f"cam{c:02d}/frame_{t:05d}.jpg" for c in range(3) for t in range(3)])
    stubs(root, "colmap/database.db", "calibration.json")
    with pytest.raises(CaptureError) as refused:
        recognise(root)
    stubs(root, "intri.yml", "extri.yml")
    with pytest.raises(CaptureError, match=r"no file that is read gives their poses \(seen: .*extri\.yml, intri\.yml"):
        recognise(root)
    for words in ("cam00, cam01, cam02", "cameras of a rig", "poses_bounds.npy", "calibration.json"):
        assert words in str(refused.value)


@pytest.mark.parametrize("folder", ["images", "data"])
def test_a_rig_without_poses_in_a_folder_is_told_so_at_once(tmp_path, folder):
    """Not to pass that folder, which would be refused in its turn."""
    root = pictures(tmp_path / "rig", [f"{folder}/cam{c}/{t:04d}.png" for c in range(3) for t in range(3)])
    with pytest.raises(CaptureError) as refused:
        recognise(root)
    for words in (f"{folder}/cam0, {folder}/cam1, {folder}/cam2", "cameras of a rig", "poses_bounds.npy"):
        assert words in str(refused.value)
    assert "pass the one" not in str(refused.value)


def test_folders_of_one_time_each_are_not_told_to_be_cameras(tmp_path):
    root = pictures(tmp_path / "rig", [f"mv_images/{t:05d}/cam{c:02d}.jpg" for c in range(1, 4) for t in range(4)])
    with pytest.raises(CaptureError, match=r"each seems to be one time.*Put the pictures of each camera into one folder"):
        recognise(root)


def test_folders_of_depth_and_masks_are_no_cameras(tmp_path):
    root = pictures(tmp_path / "scan", [f"{folder}/{t}.png" for folder in ("lowres_wide", "lowres_depth", "sem_masks") for t in range(3)])
    with pytest.raises(
        CaptureError, match="It has the folders lowres_depth, lowres_wide, sem_masks: pass the one that holds images or videos"
    ):
        recognise(root)


def test_rigs_of_several_scenes_are_a_choice(tmp_path):
    root = pictures(tmp_path / "rig", [f"scene{s}/cam{c}/{t:04d}.png" for s in range(2) for c in range(3) for t in range(3)])
    with pytest.raises(CaptureError, match="It has the folders scene0, scene1: pass the one"):
        recognise(root)


def test_the_search_is_bounded(tmp_path, monkeypatch):
    root = photos(tmp_path, *(f"{'d/' * deep}a.ply" for deep in range(1, 14)))
    (root / "circle").symlink_to(root)
    found = unread(root, "images", [f"IMG_{i}.JPG" for i in range(4)])
    assert found[0].startswith("8 point clouds (first d/a.ply)") and "more than 8 deep" in found[1]
    monkeypatch.setattr(walking, "MOST_FILES", 3)
    assert not walking.tree(root).whole and len(walking.tree(root).files) == 3


def test_what_the_readers_notes_name_is_skipped(tmp_path):
    root = photos(tmp_path, "sparse/1/cameras.bin", "sparse/1/images.bin", "a.ply", "b.ply", "more/c.ply")
    read = [f"IMG_{i}.JPG" for i in range(4)]
    for model in ("sparse/1", "sparse/1/images.bin"):
        found = unread(root, "colmap", read, (model, "b.ply", "more/"))
        assert found == ("the point cloud a.ply is not read, because the layout is colmap",)
    model, clouds = unread(root, "colmap", read)
    assert model.startswith("the COLMAP model in sparse/1 is not read") and clouds.startswith("3 point clouds")


CARDS = {
    "GoPro": ("GX0100{}.MP4", "GL0100{}.LRV", "GX0100{}.THM"),
    "GoPro before HERO6": ("GOPR00{}.MP4", "GOPR00{}.LRV", "GOPR00{}.THM"),
    "DJI": ("DJI_00{}.MP4", "DJI_00{}.LRF", "DJI_00{}.THM"),
    "Insta360": ("VID_20240101_1200{}_00_0{}.mp4", "LRV_20240101_1200{}_01_0{}.lrv", "VID_20240101_1200{}_00_0{}.thm"),
}


@pytest.mark.parametrize("count", [1, 3])
@pytest.mark.parametrize("camera", CARDS)
def test_what_cameras_write_beside_clips_is_no_question(tmp_path, camera, count):
    video, low, thumbnail = CARDS[camera]
    for k in range(34, 34 + count):
        encode(tmp_path / video.format(k, k), levels(4 + 4 * (k - 34)))
        stubs(tmp_path, low.format(k, k), thumbnail.format(k, k))
    capture = recognise(tmp_path)
    assert (capture.facts["format"], capture.facts["cameras"]) == ("video" if count == 1 else "videos", count)
    tiny, small = sorted(lines(tmp_path), key=lambda line: "low" in line)
    assert tiny.endswith("not read") and "thumbnail" in tiny
    assert small.endswith("not read; the video itself is" if count == 1 else "not read; the videos themselves are")


def test_a_low_resolution_copy_alone_is_told_what_to_do(tmp_path):
    root = stubs(tmp_path, "GL010034.LRV")
    for path in (root, root / "GL010034.LRV"):
        with pytest.raises(CaptureError, match=r"low-resolution copy.*: pass the video in full resolution, or rename it to end in \.mp4"):
            recognise(path)


def test_kinds_of_names():
    assert kind_of("a/b.JPG") is PICTURE and kind_of("x.M2TS") is VIDEO and kind_of("transforms_train.json") is POSE
    assert kind_of("cam/README.md") is kind_of("config.json") is kind_of("script.py") is None
    assert colour_only(["depth_1.png", "depth_2.png"]) == ["depth_1.png", "depth_2.png"], "without colours they are the pictures"
    assert colour_only(["1.png", "depth_1.png", "depth_2.png"]) == ["1.png", "depth_2.png"]
    masks = ["a.jpg.mask.png", "a.mask.png", "a_mask.png", "dynamic_mask_a.png"]
    assert colour_only(["a.jpg", *masks, "b.jpg.mask.png"]) == ["a.jpg", "b.jpg.mask.png"]
    assert [kind_of(name) is DYNAMIC for name in masks] == [False, False, False, True]


COPIES = ("IMG_0 (1).JPG", "IMG_0(2).jpg", "IMG_1 copy.JPG", "IMG_1 - Copy (3).JPG", "Copy of IMG_2.JPG", "IMG_2_copy.JPG")
COPIES += (
    "IMG_1 2.JPG",
    "IMG_0 - Kopie.JPG",
    "IMG_2 (copie).JPG",
    "Kopie von IMG_1.JPG",
    "IMG_1.sync-conflict-20240101-120000-ABCDEFG.JPG",
)


@pytest.mark.parametrize("name", COPIES)
def test_a_copy_of_a_photo_is_no_time_of_its_own(tmp_path, name):
    root = photos(tmp_path)
    source = next(part for part in ("IMG_0", "IMG_1", "IMG_2") if part in name)
    shutil.copy(root / f"{source}.JPG", root / name)
    capture = recognise(root, fps=30)
    assert capture.images == tuple(f"IMG_{i}.JPG" for i in range(4))
    assert capture.notes == (f"{name} is left out: it is a copy of {source}.JPG, byte for byte",)
    assert name in capture.files  # the result changes if it does
    (root / name).write_bytes((root / "IMG_3.JPG").read_bytes())  # another picture
    assert recognise(root, fps=30).facts["frames"] == 5 and recognise(root, fps=30).notes == ()


@pytest.mark.parametrize("count", [1, 3, 6])
@pytest.mark.parametrize(
    "name",
    [
        *("IMG_E{:04d}.JPG", "img_e{:04d}.png", "IMG_{:04d}-edited.JPG", "IMG_{:04d}~2.JPG"),
        *("IMG_{:04d}-Edit.jpg", "IMG_{:04d}-Enhanced-NR.jpg", "IMG_{:04d}_DxO.jpg"),
    ],
)
def test_edited_photos_beside_their_originals_are_no_times(tmp_path, name, count):
    originals = [f"IMG_{i:04d}.JPG" for i in range(6)]
    edits = [name.format(i) for i in range(count)]
    root = pictures(tmp_path / "photos", [*originals, *edits])
    capture = recognise(root)
    assert list(capture.names) == originals
    (note,) = [note for note in capture.notes if "edited" in note]
    assert edits[0] in note and "IMG_0000.JPG" in note and not lines(root)


def test_a_portrait_of_a_pixel_is_read_with_its_background(tmp_path):
    names = [f"PXL_2023_{i}.PORTRAIT-{kind}.jpg" for i in range(3) for kind in ("01.COVER", "02.ORIGINAL")]
    capture = recognise(pictures(tmp_path / "s", names))
    assert capture.names == tuple(names[1::2])


def test_an_edited_photo_without_its_original_is_read(tmp_path):
    root = pictures(tmp_path / "photos", ["IMG_0001.JPG", "IMG_0002.JPG", "IMG_E0003.JPG", "IMG_EAST.JPG"])
    assert len(recognise(root).names) == 4


def test_an_edited_clip_is_no_camera(tmp_path):
    for name, step in (("IMG_0001.MOV", 10), ("IMG_E0001.MOV", 9)):
        encode(tmp_path / name, levels(12, step))
    capture = recognise(tmp_path)
    assert capture.facts["cameras"] == 1 and {name.split("#")[0] for name in capture.names} == {"IMG_0001.MOV"}
    assert any(note.startswith("IMG_E0001.MOV is left out: by its name it is an edited version") for note in capture.notes)
    encode(tmp_path / "IMG_0002.MOV", levels(12, 8))
    capture = recognise(tmp_path)
    assert capture.facts["cameras"] == 2 and not lines(tmp_path)


def test_photos_with_the_same_bytes_are_times_of_a_scene_that_stands_still(tmp_path):
    root = pictures(tmp_path / "photos", ["a (1).png"])
    for i in range(2, 5):
        shutil.copy(root / "a (1).png", root / f"a ({i}).png")
    assert recognise(root, fps=30).facts["frames"] == 4 and recognise(root, fps=30).notes == ()


def test_a_copy_of_a_video_is_no_camera(videos_capture, tmp_path):
    root = shutil.copytree(videos_capture.root, tmp_path / "rig")
    whole = recognise(root)
    first = sorted(path.name for path in root.glob("*.mp4"))[0]
    shutil.copy(root / first, root / "0 copy.mp4")
    capture = recognise(root)
    assert capture.facts["cameras"] == whole.facts["cameras"] and [v.file for v in capture.videos] == [v.file for v in whole.videos]
    assert f"0 copy.mp4 is left out: it is a copy of {first}, byte for byte" in capture.notes
    assert len(capture.notes) == len(whole.notes) + 1 and "0 copy.mp4" in capture.files


def test_copies_of_one_video_are_no_rig(videos_capture, tmp_path):
    source = sorted(videos_capture.root.glob("*.mp4"))[0]
    for name in ("a.mp4", "a copy.mp4"):
        shutil.copy(source, tmp_path / name)
    with pytest.raises(CaptureError, match=r"copies of one, byte for byte; pass that one: .*/a\.mp4"):
        recognise(tmp_path)


@pytest.mark.parametrize(
    ("colour", "bands"),
    [
        ("DJI_20240101120000_00{0}0_D.JPG", [f"DJI_20240101120000_00{{0}}0_MS_{band}.TIF" for band in ("G", "R", "RE", "NIR")]),
        ("DJI_00{0}0.JPG", [f"DJI_00{{0}}{k}.TIF" for k in range(1, 6)]),
    ],
)
def test_of_a_multispectral_camera_only_the_colour_pictures_are_read(tmp_path, colour, bands):
    for k in range(1, 4):
        Image.new("RGB", (16, 12), (k, 0, 0)).save(tmp_path / colour.format(k))
        for band in bands:
            Image.fromarray(np.full((8, 10), 1000 * k, np.uint16)).save(tmp_path / band.format(k))
    found = recognise(tmp_path)
    assert list(found.files) == [colour.format(k) for k in range(1, 4)]
    first = min(band.format(1) for band in bands)
    assert lines(tmp_path) == [
        f"{3 * len(bands)} pictures of one band of light (first {first}) are not read, because colours are learned from the colour "
        "pictures of the same views"
    ]


def test_bands_alone_are_pictures_like_others(tmp_path):
    for k in range(1, 4):
        Image.fromarray(np.full((8, 10), 1000 * k, np.uint16)).save(tmp_path / f"DJI_00{k}0_MS_NIR.TIF")
    assert len(recognise(tmp_path).files) == 3 and lines(tmp_path) == []
