"""HDR and wide gamuts come out as an SDR camera beside them records the scene; plain SDR stays as it is."""

from fractions import Fraction

import av
import numpy as np
import pytest
from e4dgs.pipeline import CaptureError
from e4dgs.stages.captures import recognise
from e4dgs.stages.captures.formats.video import decode
from e4dgs.stages.captures.video.colour import Tags, colours_told, frame_tags
from e4dgs.vision.images.wide_colour import from_gamut, to_sdr
from run_stage import run_frames
from tiny_videos import encode, levels, remux

BT2020_FROM_709 = np.array([[0.627404, 0.329283, 0.043313], [0.069097, 0.919540, 0.011362], [0.016391, 0.088013, 0.895595]])  # BT.2087
LUMA = np.array([0.2627, 0.6780, 0.0593])
COLOURS = np.array(
    [[220, 40, 41], [40, 200, 60], [30, 60, 210], [128, 128, 128], [235, 235, 235], [12, 12, 12], [200, 180, 40], [90, 20, 110]]
)
TRANSFERS = {"HLG": 18, "PQ": 16, "SDR": 14}


def linear(codes):
    codes = np.asarray(codes) / 255
    return np.where(codes <= 0.04045, codes / 12.92, ((codes + 0.055) / 1.055) ** 2.4)


def signal(codes, curve):
    """R'G'B' in [0, 1] of sRGB codes with white at 203 cd/m2, by the formulas of BT.2100 (for SDR: of sRGB)."""
    light = linear(codes) @ BT2020_FROM_709.T
    if curve == "PQ":
        power = (light * 203 / 10000) ** 0.1593017578125
        return ((0.8359375 + 18.8515625 * power) / (1 + 18.6875 * power)) ** 78.84375
    if curve == "SDR":
        return np.where(light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 1e-9) ** (1 / 2.4) - 0.055)
    shown = light * 203 / 1000
    scene = shown * np.maximum(shown @ LUMA, 1e-9)[..., None] ** (1 / 1.2 - 1)
    return np.where(scene <= 1 / 12, np.sqrt(3 * scene), 0.17883277 * np.log(np.maximum(12 * scene - 0.28466892, 1e-9)) + 0.55991073)


def bars():
    """[48,64,3] uint8: eight patches."""
    return COLOURS.reshape(2, 4, 3).repeat(24, 0).repeat(16, 1).astype(np.uint8)


def wide_video(file, curve, count=3, codec="libx265", tagged=True):
    """10 bits, BT.2020, limited range. tagged: the tags are in the stream."""
    with av.open(str(file), "w") as container:
        options = {"x265-params": "log-level=none:qp=4:pools=1"} if codec == "libx265" else {"qp": "2"}
        stream = container.add_stream(codec, rate=10, options=options)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv444p10le"
        if tagged:
            tag(stream.codec_context, curve)
        codes = signal(bars(), curve)
        luma = codes @ LUMA
        values = (64 + 876 * luma, 512 + 896 * (codes[..., 2] - luma) / 1.8814, 512 + 896 * (codes[..., 0] - luma) / 1.4746)
        for k in range(count):
            frame = av.VideoFrame(64, 48, "yuv444p10le")
            for plane, value in zip(frame.planes, values, strict=True):
                row = np.zeros((48, plane.line_size // 2), np.uint16)
                row[:, :64] = np.rint(value)
                plane.update(row.tobytes())
            if tagged:
                frame.colorspace, frame.color_range = 9, 1
            frame.pts, frame.time_base = k, Fraction(1, 10)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return file


def tag(context, curve):
    context.color_trc, context.color_primaries, context.colorspace, context.color_range = TRANSFERS[curve], 9, 9, 1


def patches(picture):
    """[8,3]: the middle of each patch."""
    return np.array([picture[24 * (k // 4) + 12, 16 * (k % 4) + 8] for k in range(8)]).astype(int)


def read(file):
    capture = recognise(file)
    return capture, next(decode(capture.root, capture.videos[0], 64, 48))


@pytest.mark.parametrize("curve", ["HLG", "PQ", "SDR"])
@pytest.mark.parametrize("suffix", ["mov", "mkv", "ts"])
def test_colours_come_out_as_in_sdr(tmp_path, curve, suffix):
    capture, picture = read(wide_video(tmp_path / f"clip.{suffix}", curve))
    assert np.abs(patches(picture) - COLOURS).max() <= 4, "235 is a little darker, because of the highlights above"
    assert np.abs(patches(picture) - COLOURS)[0].max() <= 2, "(220, 40, 41)"
    (line,) = capture.notes[1:]
    assert line.startswith("clip.") and ("wide gamut (BT.2020)" if curve == "SDR" else f"HDR ({curve}") in line


@pytest.mark.parametrize("codec", ["libx265", "libx264"])
def test_tags_may_be_in_the_container_alone(tmp_path, codec):
    source = wide_video(tmp_path / "source.mkv", "HLG", codec=codec, tagged=False)
    file = remux(source, tmp_path / "clip.mov", lambda packets: packets, lambda context: tag(context, "HLG"))
    with av.open(str(file)) as container:
        frame = next(container.decode(video=0))
        assert codec != "libx265" or int(frame.color_trc) == 2, "the frames say nothing"
    assert np.abs(patches(read(file)[1]) - COLOURS).max() <= 4


def test_a_rig_of_hdr_and_sdr_cameras_is_alike(tmp_path):
    (tmp_path / "rig").mkdir()
    wide_video(tmp_path / "rig" / "a.mov", "HLG")
    wide_video(tmp_path / "rig" / "b.mov", "PQ")
    encode(tmp_path / "rig" / "c.mp4", [bars()] * 3, options={"qp": "2"}, pix_fmt="yuv444p")
    frames = run_frames(tmp_path / "rig", tmp_path / "out").artifact
    first = frames.read("images")[[0, 3, 6]].astype(int)
    assert np.abs(first - bars()).mean() < 1.5 and np.ptp(first.mean((1, 2)), 0).max() < 2


def test_plain_colours_are_those_of_the_file(tmp_path):
    file = encode(tmp_path / "clip.mp4", [bars()] * 3)
    with av.open(str(file)) as container:
        expected = next(container.decode(video=0)).to_ndarray(format="rgb24")
    capture, picture = read(file)
    assert (picture == expected).all() and len(capture.notes) == 1


def test_light_above_white_stays_in_order_and_hues_stay():
    grey = to_sdr(np.arange(65536, dtype=np.uint16).reshape(256, 256, 1).repeat(3, 2), "PQ", "BT.2020").reshape(-1, 3).astype(int)
    assert (np.diff(grey, axis=0) >= 0).all() and (grey == grey[:, :1]).all() and grey[-1, 0] == 255
    white = signal(np.full(3, 255), "PQ")
    assert to_sdr(np.rint(white * 65535).astype(np.uint16)[None, None], "PQ", "BT.2020")[0, 0, 0] in range(248, 254)
    code = np.rint(signal(np.array([[[255, 130, 20]]]), "HLG") * 65535).astype(np.uint16)
    result = linear(to_sdr(code, "HLG", "BT.2020")[0, 0])
    np.testing.assert_allclose(result / result[0], linear([255, 130, 20]) / linear([255])[0], atol=0.01)


def test_the_matrix_of_bt2020_is_that_of_bt2087():
    np.testing.assert_allclose(from_gamut("BT.2020") @ BT2020_FROM_709, np.eye(3), atol=1e-5)
    np.testing.assert_allclose(from_gamut("P3") @ np.ones(3), np.ones(3), atol=1e-6)


@pytest.mark.parametrize(
    ("pix_fmt", "full"), [("yuv420p10le", False), ("yuv422p10le", True), ("yuv420p12le", False), ("yuv444p12le", True), ("yuv420p", False)]
)
def test_greys_of_every_depth_and_range_keep_their_codes(pix_fmt, full):
    """The scale of FFmpeg's 16-bit pictures is known: SDR greys with wide primaries stay as they are."""
    from e4dgs.stages.captures.video.colour import rgb_of

    bits = {"10": 10, "12": 12}.get(pix_fmt[-4:-2], 8)
    low, high = (0, 2**bits - 1) if full else (16 << bits - 8, 235 << bits - 8)
    frame = av.VideoFrame(64, 16, pix_fmt)
    for number, plane in enumerate(frame.planes):
        kind = np.uint8 if bits == 8 else np.uint16
        row = np.full((plane.height, plane.line_size // np.dtype(kind).itemsize), 1 << bits - 1, kind)
        if number == 0:
            row[:, :64] = np.rint(np.linspace(low, high, 64))
        plane.update(row.tobytes())
    frame.colorspace, frame.color_range = 9, 2 if full else 1
    picture = rgb_of(frame, Tags(14, 9, 9)).astype(int)
    assert np.abs(picture[8] - np.linspace(0, 255, 64)[:, None]).max() <= (2.5 if bits == 8 else 1.1)


def test_colours_that_cannot_be_shown_are_refused():
    with pytest.raises(CaptureError, match=r"a\.mp4: colours coded as ICtCp"):
        colours_told(Tags(16, 9, 14), "a.mp4", "hvc1")
    with pytest.raises(CaptureError, match=r"a\.mp4: Dolby Vision without"):
        colours_told(Tags(), "a.mp4", "dvh1")
    assert colours_told(Tags(18, 9, 9), "a.mp4", "dvh1") is not None, "profile 8.4 has an HLG base"


def test_every_wide_gamut_is_converted_or_told():
    for code in (11, 12):
        assert Tags(1, code, 1).gamut == "P3" and colours_told(Tags(1, code, 1), "a.mp4", "avc1").startswith("its wide gamut (P3)")
    assert "(film) are not converted" in colours_told(Tags(1, 8, 1), "a.mp4", "avc1")
    both = colours_told(Tags(17, 11, 1), "a.mov", "avc1")
    assert "transfer curve (SMPTE 428) is not converted" in both and "wide gamut (P3) is converted" in both
    assert all(colours_told(Tags(1, code, 1), "a.mp4", "avc1") is None for code in (1, 2, 5, 6, 7, 22))


@pytest.mark.parametrize(
    ("name", "codec", "pix_fmt", "words"),
    [
        ("a.mov", "qtrle", "argb", "ffmpeg -i FILE -pix_fmt rgba FRAMES/%05d.png"),
        ("a.mov", "qtrle", "rgb24", None),
        ("a.mkv", "ffv1", "bgra", "ffmpeg -i FILE"),
        ("a.mkv", "ffv1", "bgr0", None),
        ("a.mov", "prores_ks", "yuva444p10le", "ffmpeg -i FILE"),
        ("a.webm", "libvpx-vp9", "yuva420p", "ffmpeg -c:v libvpx-vp9 -i FILE"),
        ("a.gif", "gif", "rgb8", None),
    ],
)
def test_alpha_that_is_not_read_is_told(tmp_path, name, codec, pix_fmt, words):
    notes = recognise(encode(tmp_path / name, [bars()] * 3, codec, pix_fmt=pix_fmt)).notes
    told = [note for note in notes if note.startswith(f"{name}: its alpha channel is not read")]
    assert len(told) == (words is not None) and all(words in note for note in told), notes


def test_the_frame_has_the_last_word():
    frame = av.VideoFrame(16, 16, "yuv420p")
    frame.colorspace = 1
    assert frame_tags(frame, Tags(18, 9, 9)) == Tags(18, 9, 1)


@pytest.mark.parametrize(
    ("size", "matrix", "taken", "told"),
    [
        ((1280, 720), None, "709", True),
        ((404, 720), None, "709", True),
        ((1280, 640), None, "709", True),
        ((1278, 718), None, "601", False),
        ((1280, 720), 6, "601", False),
        ((640, 480), 1, "709", False),
    ],
)
def test_hd_video_that_states_no_matrix_has_that_of_players(tmp_path, size, matrix, taken, told):
    """FFmpeg's converter takes BT.601 for all sizes, which shifts these colours by up to 27 of 255."""
    red, blue = {"709": (0.2126, 0.0722), "601": (0.299, 0.114)}[taken]
    width, height = size
    codes = COLOURS.repeat(width // 8 + 1, 0)[:width] / 255
    luma = codes @ (red, 1 - red - blue, blue)
    planes = (
        16 + 219 * luma,
        128 + 224 * (codes[:, 2] - luma) / (2 - 2 * blue),
        128 + 224 * (codes[:, 0] - luma) / (2 - 2 * red),
    )
    file = tmp_path / "clip.mkv"
    with av.open(str(file), "w") as container:
        stream = container.add_stream("libx264", rate=10, options={"qp": "2", "preset": "ultrafast"})
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv444p"
        if matrix is not None:
            stream.codec_context.colorspace = matrix
        for k in range(2):
            frame = av.VideoFrame(width, height, "yuv444p")
            for plane, value in zip(frame.planes, planes, strict=True):
                row = np.zeros((height, plane.line_size), np.uint8)
                row[:, :width] = np.rint(value)
                plane.update(row.tobytes())
            if matrix is not None:
                frame.colorspace = matrix
            frame.pts, frame.time_base = k, Fraction(1, 10)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    capture = recognise(file)
    shown = next(decode(capture.root, capture.videos[0], width, height))
    step = width // 8 + 1
    found = shown[height // 2, [min(width - 4, step * k + step // 2) for k in range(8)]]
    assert np.abs(found.astype(int) - COLOURS).max() <= 4
    assert any("BT.709 is taken" in note for note in capture.notes) is told


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ('<Item name="CaptureGammaEquation" value="s-log3-cine"/>', True),
        ('<Item name="CaptureGammaEquation" value="rec709"/>', False),
        ('<!DOCTYPE a [<!ENTITY b "&b;&b;">]>&b;' + "<" * 70000 + '<Item name="CaptureGammaEquation" value="s-log3"/>', False),
        ("", False),
    ],
)
def test_log_footage_is_named_by_the_file_beside_it(tmp_path, text, told):
    (tmp_path / "C0001M01.XML").write_text(text)
    encode(tmp_path / "C0001.MP4", levels(3, 2, (32, 24)))
    found = [note for note in recognise(tmp_path / "C0001.MP4").notes if "log" in note]
    assert bool(found) == told
    assert all("C0001.MP4: recorded as s-log3-cine (C0001M01.XML), which is not converted: convert it to Rec.709" in n for n in found)


@pytest.mark.parametrize(("transfer", "told"), [(1, True), (2, True), (14, False), (16, False)])
def test_footage_with_the_tags_of_apple_log_is_doubted(transfer, told):
    assert ("if it is log footage" in (colours_told(Tags(transfer, 9, 9), "a.mov", "hvc1") or "")) == told
