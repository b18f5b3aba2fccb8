"""The shape in which a video is shown: pixels that are not square, turned, mirrored, interlaced, and sizes that change."""

import shutil
from fractions import Fraction
from types import SimpleNamespace

import av
import cv2
import numpy as np
import pytest
from av.sidedata.sidedata import Type
from e4dgs.pipeline import CaptureError
from e4dgs.stages.captures import recognise
from e4dgs.stages.captures.formats.video import decode
from e4dgs.stages.captures.panorama import refuse_video
from e4dgs.stages.captures.video.shape import Shape, axis_turn, eyes_told
from PIL import Image
from run_stage import run_frames
from tiny_videos import box, encode, turn


def corner():
    """[48,64,3]: bright above, red on the left, so that every turn looks different."""
    picture = np.full((48, 64, 3), 60, np.uint8)
    picture[:12] = 200
    picture[:, :16] = (220, 40, 40)
    return picture


def first(file):
    capture = recognise(file)
    size = capture.facts["width"], capture.facts["height"]
    return capture, next(decode(capture.root, capture.videos[0], *size)).astype(int)


def test_wide_pixels_are_made_square(tmp_path):
    """A disc is stored as an ellipse and comes out as a disc."""
    disc = np.zeros((96, 128, 3), np.uint8)
    cv2.circle(disc, (64, 48), 30, (255, 255, 255), -1)
    stored = cv2.resize(disc, (96, 96), interpolation=cv2.INTER_AREA)
    capture, picture = first(encode(tmp_path / "clip.mp4", [stored] * 3, pixel=Fraction(4, 3)))
    assert (capture.facts["width"], capture.facts["height"]) == (96, 72)
    bright = picture[..., 0] > 127
    assert abs(np.ptp(np.flatnonzero(bright.any(0))) - np.ptp(np.flatnonzero(bright.any(1)))) <= 1
    assert capture.notes[1:] == ("clip.mp4: pixels are 4:3 as wide as high: 96x96 is scaled to 96x72",)


def test_wide_pixels_turn_with_the_picture(tmp_path):
    file = turn(encode(tmp_path / "clip.mp4", [corner()] * 3, pixel=Fraction(4, 3)), 0, 1, -1, 0)
    capture, picture = first(file)
    assert (capture.facts["width"], capture.facts["height"]) == (36, 64), "64x48 shows as 64x36, then upright"
    assert picture[32, 34, 1] > 150 and picture[2, 10, 0] > 180 > 90 > picture[2, 10, 1], "turned clockwise: red above, bright on the right"


@pytest.mark.parametrize("ratio", [Fraction(1), Fraction(1, 8), Fraction(9, 1)])
def test_square_and_impossible_pixels_change_nothing(tmp_path, ratio):
    capture, _ = first(encode(tmp_path / "clip.mp4", [corner()] * 3, pixel=ratio))
    assert (capture.facts["width"], capture.facts["height"]) == (64, 48)
    assert len(capture.notes) == (1 if ratio == 1 else 2)


def test_the_longer_side_is_kept():
    assert Shape((1440, 1080), Fraction(4, 3)).shown == (1440, 810)
    assert Shape((720, 480), Fraction(8, 9)).shown == (720, 540)
    assert Shape((720, 576), Fraction(16, 15), (0, 1, -1, 0)).shown == (540, 720)


TURNS = {
    (1, 0, 0, 1): lambda p: p,
    (-1, 0, 0, 1): lambda p: p[:, ::-1],
    (1, 0, 0, -1): lambda p: p[::-1],
    (-1, 0, 0, -1): lambda p: p[::-1, ::-1],
    (0, 1, -1, 0): lambda p: np.rot90(p, -1),  # clockwise, as FFmpeg's transpose=clock
    (0, -1, 1, 0): np.rot90,
    (0, 1, 1, 0): lambda p: p.transpose(1, 0, 2),  # FFmpeg's transpose=cclock_flip
    (0, -1, -1, 0): lambda p: p.transpose(1, 0, 2)[::-1, ::-1],
}


@pytest.mark.parametrize("matrix", TURNS)
@pytest.mark.parametrize("suffix", ["mp4", "mov"])
def test_every_display_matrix_is_followed(tmp_path, matrix, suffix):
    plain = encode(tmp_path / f"plain.{suffix}", [corner()] * 2)
    stored = first(plain)[1]
    file = turn(shutil.copy(plain, tmp_path / f"clip.{suffix}"), *matrix)
    capture, picture = first(file)
    assert (picture == TURNS[matrix](stored)).all()
    mirrored = matrix[0] * matrix[3] - matrix[1] * matrix[2] < 0
    assert any("mirrored" in note for note in capture.notes) == mirrored
    assert sum("it is shown" in note and "as the file asks" in note for note in capture.notes) == (matrix != (1, 0, 0, 1))
    if matrix == (0, 1, -1, 0):
        assert capture.notes[1:] == (f"clip.{suffix}: it is shown turned by 90 degrees clockwise, as the file asks",)


@pytest.mark.parametrize(
    ("matrix", "line"),
    [
        (
            (0.866, -0.5, 0.5, 0.866),
            "would turn it by 30 degrees counterclockwise; only quarter turns and mirroring are followed, so it is shown as stored",
        ),
        (
            (-0.5, 0.866, -0.866, -0.5),
            "would turn it by 120 degrees clockwise; only quarter turns and mirroring are followed, so it is shown "
            "turned by 90 degrees clockwise",
        ),
        ((1, 0.5, 0.5, 1), "would skew it; only quarter turns and mirroring are followed, so it is shown as stored"),
        ((0, 0, 0, 0), None),
        ((0.9999, 0.001, -0.001, 0.9999), None),
    ],
)
def test_a_display_matrix_that_is_not_followed_is_told(tmp_path, matrix, line):
    notes = first(turn(encode(tmp_path / "clip.mp4", [corner()] * 2), *matrix))[0].notes[1:]
    assert [line is not None and f"clip.mp4: its display matrix {line}" in note for note in notes] == [True] * (line is not None)


def test_matrices_are_taken_to_the_nearest_axes():
    one = 1 << 16
    assert axis_turn((0, 0, 0, 0)) == (1, 0, 0, 1)
    assert axis_turn((one, 9, -9, one)) == (1, 0, 0, 1)
    assert axis_turn((-2 * one, 0, 0, one)) == (-1, 0, 0, 1)
    assert axis_turn((100, one, -one, -100)) == (0, 1, -1, 0)


def joined(file, sizes):
    """VP8, as a browser records a call: the size changes at a key frame."""
    with av.open(str(file), "w") as container:
        stream = container.add_stream("libvpx", rate=10)
        stream.width, stream.height, stream.pix_fmt = *sizes[0], "yuv420p"
        number = 0
        for width, height in sizes:
            context = av.CodecContext.create("libvpx", "w")
            context.width, context.height, context.pix_fmt = width, height, "yuv420p"
            context.time_base, context.options = Fraction(1, 10), {"lag-in-frames": "0", "auto-alt-ref": "0"}
            packets = []
            for k, picture in enumerate([cv2.resize(corner(), (width, height))] * 4):
                frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
                frame.pts, frame.time_base = k, Fraction(1, 10)
                packets += context.encode(frame)
            for packet in packets + context.encode():
                packet.pts = packet.dts = number
                packet.time_base, packet.stream = Fraction(1, 10), stream
                number += 1
                container.mux(packet)
    return file


def test_another_shape_in_the_middle_is_refused_by_frame_and_sizes(tmp_path):
    with pytest.raises(CaptureError, match=r"clip\.webm: frame 4: 48x64, but the video begins with 64x48; cut it"):
        run_frames(joined(tmp_path / "clip.webm", [(64, 48), (48, 64)]), tmp_path / "out")


def test_another_size_of_one_shape_is_scaled_and_told(tmp_path):
    capture = recognise(joined(tmp_path / "clip.webm", [(64, 48), (32, 24)]))
    lines = []
    pictures = [p.astype(int) for p in decode(tmp_path, capture.videos[0], 64, 48, None, lines.append)]
    assert len(pictures) == 8 and np.abs(pictures[0] - pictures[7]).mean() < 12
    assert lines == ["clip.webm: 4 frames have another size and the same shape; they are scaled"]


def balls(count):
    """A camera that stands still, with noise of its own, and a ball that moves."""
    rng = np.random.default_rng(0)
    wall = cv2.resize(rng.integers(40, 216, (12, 16, 3), np.uint8), (128, 96), interpolation=cv2.INTER_CUBIC)
    pictures = []
    for k in range(count):
        picture = wall.copy()
        cv2.circle(picture, (20 + 3 * k, 48), 14, (240, 240, 240), -1, cv2.LINE_AA)
        pictures.append(np.clip(picture + rng.normal(0, 2, picture.shape), 0, 255).astype(np.uint8))
    return pictures


FLAGGED = {"qp": "8", "x264-params": "interlaced=1:tff=1"}


def test_fields_of_two_times_are_deinterlaced(tmp_path):
    pictures = balls(24)
    woven = [pictures[2 * k].copy() for k in range(12)]
    for k in range(12):
        woven[k][1::2] = pictures[2 * k + 1][1::2]
    capture = recognise(encode(tmp_path / "clip.mp4", woven, options=FLAGGED))
    assert capture.notes[1:] == ("clip.mp4: interlaced: deinterlaced",) and capture.facts["frames"] == 12
    result = list(decode(tmp_path, capture.videos[0], 128, 96))
    assert len(result) == 12
    for k in range(2, 10):
        moved = np.abs(pictures[2 * k].astype(int) - pictures[2 * k + 1]).max(2) > 60
        off, combed = (np.abs(p.astype(int) - pictures[2 * k])[moved].mean() for p in (result[k], woven[k]))
        assert off < 0.7 * combed, "the picture of the first field's time"


def test_whole_frames_that_are_flagged_stay_as_they_are(tmp_path):
    file = encode(tmp_path / "clip.mp4", balls(12), options=FLAGGED)
    with av.open(str(file)) as container:
        frames = list(container.decode(video=0))
        assert all(frame.interlaced_frame for frame in frames)
        expected = [frame.to_ndarray(format="rgb24") for frame in frames]
    capture = recognise(file)
    assert capture.notes[1:] == ("clip.mp4: flagged as interlaced, but its frames are whole: left as they are",)
    assert all((a == b).all() for a, b in zip(decode(tmp_path, capture.videos[0], 128, 96), expected, strict=True))


def test_poses_are_held_against_the_shape_as_shown(n3v_capture, tmp_path):
    """Anamorphic videos with poses for the stored shape do not fit; with poses for the shown shape they do."""
    root = shutil.copytree(n3v_capture.root, tmp_path / "rig")
    table = np.load(root / "poses_bounds.npy")
    for file in sorted(root.glob("cam*.mp4")):
        with av.open(str(file)) as container:
            pictures = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
        encode(file, pictures, pixel=Fraction(4, 3))
    with pytest.raises(CaptureError, match=r"made for 80x64, but cam00.mp4 is 80x48, which has another aspect ratio"):
        recognise(root)
    table[:, 9] *= 4 / 3  # w
    np.save(root / "poses_bounds.npy", table)
    capture = recognise(root)
    assert any("pixels are 4:3" in note for note in capture.notes)


def test_y4m_is_a_video(tmp_path):
    """As programs pass raw pictures to each other, with and without a folder around it."""
    file = tmp_path / "clip.y4m"
    with av.open(str(file), "w", format="yuv4mpegpipe") as container:
        stream = container.add_stream("wrapped_avframe", rate=25)
        stream.width, stream.height, stream.pix_fmt = 32, 24, "yuv420p"
        for i in range(6):
            frame = av.VideoFrame.from_ndarray(np.full((24, 32, 3), 40 * i, np.uint8), format="rgb24").reformat(format="yuv420p")
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    for path in (file, tmp_path):
        capture = recognise(path)
        assert capture.facts["format"] == "video" and capture.facts["frames"] == 6
    assert first(file)[1].max() <= 2


def round_about(file):
    """Puts Google's tags of a 360-degree video behind the content of an MP4's track, which is the last one."""
    space = "http://ns.google.com/videos/1.0/spherical/"
    words = "".join(
        f"<GSpherical:{name}>{value}</GSpherical:{name}>"
        for name, value in (("Spherical", "true"), ("Stitched", "true"), ("StitchingSoftware", "x"), ("ProjectionType", "equirectangular"))
    )
    text = f'<?xml version="1.0"?><rdf:SphericalVideo xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#" xmlns:GSpherical="{space}">'
    tags = box(b"uuid", bytes.fromhex("ffcc8263f8554a938814587a02521fdd") + f"{text}{words}</rdf:SphericalVideo>".encode())
    data = bytearray(file.read_bytes())
    track = data.rindex(b"trak") - 4
    moov = data.rindex(b"moov", 0, track) - 4
    end = track + int.from_bytes(data[track : track + 4], "big")
    for at in (moov, track):
        data[at : at + 4] = (int.from_bytes(data[at : at + 4], "big") + len(tags)).to_bytes(4, "big")
    data[end:end] = tags
    file.write_bytes(data)
    return file


@pytest.mark.parametrize("others", [0, 1])
def test_a_360_degree_video_is_no_flat_view(tmp_path, others):
    for k in range(others):
        encode(tmp_path / f"a{k}.mp4", [corner()] * 3)
    round_about(encode(tmp_path / "clip.mp4", [corner()[:32]] * 3))
    with pytest.raises(CaptureError, match=r"clip\.mp4: a 360-degree video.*reframe it.* v360=e:flat:h_fov=90:v_fov=60 flat\.mp4"):
        recognise(tmp_path)


@pytest.mark.parametrize(("projection", "words"), [(1, "c3x2"), (3, "a 180-degree video.*hequirect"), (5, "another projection"), (4, None)])
def test_of_the_projections_only_the_rectilinear_one_is_read(projection, words):
    """Spatial videos of phones state that theirs is rectilinear."""
    frame = SimpleNamespace(side_data={Type.SPHERICAL: projection.to_bytes(4, "little") + bytes(32)})
    if words is None:
        refuse_video(frame, "clip.mp4")
    else:
        with pytest.raises(CaptureError, match=f"clip.mp4: .*{words}"):
            refuse_video(frame, "clip.mp4")


@pytest.mark.parametrize(("packing", "crop"), [(3, "crop=iw/2:ih:0:0,sidedata=delete"), (4, "crop=iw:ih/2:0:0,sidedata=delete"), (0, None)])
def test_two_pictures_in_one_are_no_view(tmp_path, packing, crop):
    """As the stream states, by x264's numbers, which FFmpeg passes on as it does the tags of MP4 and Matroska."""
    file = encode(tmp_path / "clip.mp4", [corner()] * 3, options={"x264-params": f"frame-packing={packing}"})
    if crop is None:
        assert recognise(file).facts["frames"] == 3
    else:
        with pytest.raises(CaptureError, match=rf"clip\.mp4: 3D video, two pictures in one; keep one: ffmpeg -i FILE -vf {crop} left\.mp4"):
            recognise(file)


@pytest.mark.parametrize(("kind", "view", "told"), [(8, 0, True), (8, 1, False), (3, 0, True), (3, 1, False), (0, 0, False)])
def test_it_is_said_if_one_eye_alone_is_read(kind, view, told):
    """Spatial videos of phones hold two eyes, of which FFmpeg decodes the main one."""
    frame = SimpleNamespace(side_data={Type.STEREO3D: np.array([kind, 0, view] + [0] * 6, np.int32).tobytes()})
    assert (eyes_told(frame, "clip.mov") is not None) is told


@pytest.mark.parametrize(
    "words", ['<rdf:Description GPano:ProjectionType="equirectangular"/>', "<GPano:ProjectionType>equirectangular</GPano:ProjectionType>"]
)
def test_360_degree_pictures_are_no_flat_views(tmp_path, words):
    """A part of a panorama, as a phone stitches it, has another shape; what was cut from one may keep its tags, too."""
    for size, refused in (((64, 32), True), ((64, 48), False)):
        root = tmp_path / str(refused)
        root.mkdir()
        for k in range(3):
            Image.new("RGB", size, (20 * k, 0, 0)).save(root / f"{k}.jpg")
            plain, about = (root / f"{k}.jpg").read_bytes(), f"http://ns.adobe.com/xap/1.0/\0<x:xmpmeta>{words}</x:xmpmeta>".encode()
            (root / f"{k}.jpg").write_bytes(plain[:2] + b"\xff\xe1" + (2 + len(about)).to_bytes(2, "big") + about + plain[2:])
        if refused:
            with pytest.raises(CaptureError, match=r"0\.jpg: a 360-degree picture \(3 of 3 pictures are\).* v360=e:flat"):
                recognise(root)
        else:
            assert recognise(root).facts["frames"] == 3


@pytest.mark.parametrize("suffix", ["insv", "OSV", "360", "BRAW"])
def test_a_file_of_a_closed_kind_gets_the_advice_of_its_folder(tmp_path, suffix):
    encode(tmp_path / "clip.mp4", [corner()] * 3).rename(tmp_path / f"clip.{suffix}")
    advice = "export it as MP4" + ("" if suffix == "BRAW" else ", reframed to a flat view")
    for path in (tmp_path, tmp_path / f"clip.{suffix}"):
        with pytest.raises(CaptureError, match=f"{suffix.upper()} video.*: {advice}"):
            recognise(path)
    assert recognise(tmp_path / f"clip.{suffix}", "video").facts["frames"] == 3, "if it is asked for, it is tried"
