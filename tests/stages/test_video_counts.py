"""Packets are no pictures: hidden, empty, trimmed and undecodable ones are left out, and every picture has its own time."""

import shutil
import struct

import numpy as np
import pytest
from e4dgs.pipeline import CaptureError
from e4dgs.stages.captures import recognise
from e4dgs.stages.captures.formats.video import decode, survey
from e4dgs.stages.captures.sound import onsets as sound
from e4dgs.stages.captures.video.hidden import is_hidden
from factory.writers import write_mp4
from PIL import Image
from run_stage import run_frames
from tiny_videos import GOP, SIZE, encode, from_key, levels, remux, with_cover, with_data

H264 = {"x264-params": GOP + ":open-gop=1", "qp": "10"}
HEVC = {"x265-params": GOP + ":open-gop=1:qp=10:log-level=none:pools=1"}


def shown(file, tell=None):
    """(capture, level index of every picture, seconds of every picture)."""
    capture = recognise(file)
    pictures = decode(capture.root, capture.videos[0], *SIZE, None, tell)
    return capture, [(float(np.median(p)) - 20) / 10 for p in pictures], capture.seconds


def check(file, expected, atol=0.35):
    """The pictures are these of `levels`, and each has its own time: a tenth of a second each."""
    capture, found, seconds = shown(file)
    np.testing.assert_allclose(found, expected, atol=atol)
    np.testing.assert_allclose(seconds, (np.array(expected) - expected[0]) / 10, atol=2e-3)
    return capture.notes[1:]


@pytest.mark.parametrize("codec", ["libx264", "libx265"])
@pytest.mark.parametrize("suffix", ["mkv", "ts", "mp4", "mov"])
def test_a_cut_at_a_key_picture_leaves_out_those_that_need_what_was_before(tmp_path, codec, suffix):
    container = "mp4" if suffix in ("mp4", "mov") else "ts" if suffix == "ts" else "mkv"
    source = encode(tmp_path / f"source.{container}", levels(23), codec, H264 if codec == "libx264" else HEVC)
    notes = check(remux(source, tmp_path / f"clip.{suffix}", from_key(1)), list(range(8, 23)))
    assert len(notes) == 1 and ("1 frame before the first that can be decoded" in notes[0] or "1 frame that its edit list" in notes[0])


def test_a_transport_stream_may_begin_anywhere(tmp_path):
    source = encode(tmp_path / "source.ts", levels(23), options=H264)
    file = remux(source, tmp_path / "clip.ts", lambda packets: packets[4:])
    (note,) = check(file, list(range(8, 23)))
    assert "frames before the first that can be decoded: left out" in note


def edits(file, parts, rate=10):
    """Replaces the edit list of an MP4 by one that shows the parts [first, last) of the pictures."""
    data = bytearray(file.read_bytes())
    at = data.index(b"elst")
    old = struct.unpack(">I", data[at - 4 : at])[0]
    movie, media = (struct.unpack(">I", data[data.index(kind) + 16 :][:4])[0] for kind in (b"mvhd", b"mdhd"))
    begin = struct.unpack(">i", data[at + 16 : at + 20])[0]
    rows = b"".join(
        struct.pack(">IiI", round((last - first) / rate * movie), begin + round(first / rate * media), 1 << 16) for first, last in parts
    )
    new = struct.pack(">I4sII", 16 + len(rows), b"elst", 0, len(parts)) + rows
    more = len(new) - old
    for kind in (b"moov", b"trak", b"edts"):
        place = data.index(kind) - 4
        data[place : place + 4] = struct.pack(">I", struct.unpack(">I", data[place : place + 4])[0] + more)
    data[at - 4 : at - 4 + old] = new
    assert data.index(b"mdat") < data.index(b"moov"), "the offsets of the samples do not change"
    file.write_bytes(data)
    return file


@pytest.mark.parametrize("bframes", ["0", "2"])
@pytest.mark.parametrize("parts", [[(10, 22)], [(0, 9)], [(11, 15)], [(17, 22)], [(2, 6), (12, 17)]], ids=str)
def test_trimmed_pictures_are_left_out(tmp_path, parts, bframes):
    options = {"x264-params": GOP.replace("bframes=2", f"bframes={bframes}"), "qp": "10"}
    file = edits(encode(tmp_path / "clip.mp4", levels(22), options=options), parts)
    expected = [k for first, last in parts for k in range(first, last)]
    capture, found, seconds = shown(file)
    np.testing.assert_allclose(found, expected, atol=0.35)
    # FFmpeg joins the parts up to a picture too early if pictures are stored in another order
    np.testing.assert_allclose(seconds, np.arange(len(expected)) / 10, atol=2e-3 if len(parts) == 1 or bframes == "0" else 0.11)
    assert (np.diff(seconds) > 0).all()
    assert capture.notes[1] == f"clip.mp4: {22 - len(expected)} frames that its edit list hides: left out"


def test_avi_counts_empty_packets(tmp_path):
    times = [0, 1, 2, 3, 9, 10, 11, 15]
    file = encode(tmp_path / "clip.avi", levels(8), "mpeg4", {"qmin": "2", "qmax": "2"}, stamps=times)
    _, found, seconds = shown(file)
    np.testing.assert_allclose(found, range(8), atol=0.35)
    np.testing.assert_allclose(seconds, np.array(times) / 10, atol=1e-6)


@pytest.mark.parametrize(
    ("codec", "options"), [("mpeg4", {"qmin": "2", "qmax": "2", "bf": "2"}), ("libx264", H264), ("libx264", {"bf": "0"})]
)
def test_avi_with_pictures_in_another_order(tmp_path, codec, options):
    assert check(encode(tmp_path / "clip.avi", levels(16), codec, options), list(range(16)), atol=0.8) == ()


def not_coded(packet, size):
    """MPEG-4's "not coded": the packet's own header of a P picture with vop_coded 0, filled up to a size."""
    data = bytes(packet)
    at = data.index(b"\0\0\1\xb6") + 4
    bits = "".join(f"{byte:08b}" for byte in data[at : at + 4])
    end = bits.index("0", 2) + 1 + 1  # kind, seconds ended by 0, marker
    width = (10 - 1).bit_length()  # of the tick: 10 frames a second
    head = "01" + bits[2 : end + width] + "1" + "0" + "1"
    head += "1" * (-len(head) % 8)
    return (data[at - 4 : at] + int(head, 2).to_bytes(len(head) // 8, "big")).ljust(size, b"\x7f")


@pytest.mark.parametrize("suffix", ["avi", "mkv", "mp4"])
def test_pictures_that_were_not_coded_are_none(tmp_path, suffix):
    source = encode(tmp_path / f"source.{suffix}", levels(16), "mpeg4", {"qmin": "2", "qmax": "2", "g": "30", "sc_threshold": "1000000000"})

    def change(packets):
        return [with_data(p, not_coded(p, 0)) if k in (6, 7) else p for k, p in enumerate(packets)]

    check(remux(source, tmp_path / f"clip.{suffix}", change), [k for k in range(16) if k not in (6, 7)], atol=0.6)


def test_packed_pictures_are_unpacked(tmp_path):
    """DivX stores a picture together with the next one, and a placeholder that is not coded behind them."""
    options = {"qmin": "2", "qmax": "2", "bf": "1", "g": "30", "sc_threshold": "1000000000", "b_strategy": "0"}
    source = encode(tmp_path / "source.avi", levels(15), "mpeg4", options)

    def change(packets):
        contents = [bytes(p)[bytes(p).index(b"\0\0\1\xb6") :] for p in packets]
        head = bytes(packets[0])[: -len(contents[0])] + b"\0\0\1\xb2DivX503b1393p"
        packed = [head + contents[0]]
        for first, second in zip(contents[1::2], contents[2::2], strict=True):
            assert (first[4] >> 6, second[4] >> 6) == (1, 2), "a P and a B picture"
            packed += [first + second, not_coded(first, 0)]
        for k, (packet, data) in enumerate(zip(packets, packed, strict=True)):
            packet.pts = packet.dts = k
            yield with_data(packet, data)

    assert check(remux(source, tmp_path / "clip.avi", lambda packets: list(change(packets))), list(range(15))) == ()


def hidden(source, file, bit):
    """Hides picture 9 and shifts it towards the next one, as encoders store reference pictures."""

    def change(packets):
        data = bytearray(bytes(packets[9]))
        data[0] ^= bit
        return [with_data(p, bytes(data)) if k == 9 else p for k, p in enumerate(packets)]

    return remux(source, file, change)


ALONE = {"lag-in-frames": "0", "auto-alt-ref": "0", "crf": "4", "b": "1M"}  # each picture has a packet of its own


@pytest.mark.parametrize("threads", ["1", "2", "3"])
def test_hidden_pictures_are_none(tmp_path, monkeypatch, threads):
    monkeypatch.setenv("OMP_NUM_THREADS", threads)
    source = encode(tmp_path / "source.webm", levels(16), "libvpx", ALONE)
    assert check(hidden(source, tmp_path / "clip.webm", 0x10), [k for k in range(16) if k != 9], atol=0.6) == ()


def test_hidden_pictures_of_vp9_are_none(tmp_path):
    """Judged by their times alone: what is hidden here can no longer be decoded, since VP9 expects further bits of it."""
    source = encode(tmp_path / "source.webm", levels(16), "libvpx-vp9", ALONE)
    seconds = recognise(hidden(source, tmp_path / "clip.webm", 0x02)).seconds
    np.testing.assert_allclose(seconds, [k / 10 for k in range(16) if k != 9], atol=2e-3)


def test_a_superframe_of_vp9_is_shown():
    assert not is_hidden("vp9", b"\x84\0\0\0\xc0") and is_hidden("vp9", b"\x84\0\0\0\0") and not is_hidden("h264", b"\0")


def with_lost(folder, lost, count=40):
    """An MPEG-4 file of which some packets turn out to have no picture only when they are decoded."""
    rng = np.random.default_rng(0)
    pictures = [np.clip(p + rng.normal(0, 6, p.shape), 0, 255).astype(np.uint8) for p in levels(count, step=5)]  # no tiny packets
    source = encode(folder / "source.mkv", pictures, "mpeg4", {"qmin": "2", "qmax": "2", "g": "100", "sc_threshold": "1000000000"})

    def change(packets):
        return [with_data(p, not_coded(p, 60)) if k in lost else p for k, p in enumerate(packets)]

    return remux(source, folder / "clip.mkv", change)


def test_a_few_lost_pictures_are_replaced_by_their_neighbours(tmp_path):
    lines = []
    capture, found, _ = shown(with_lost(tmp_path, {20}), lines.append)
    assert capture.facts["frames"] == 40 == len(found)
    np.testing.assert_allclose(np.delete(found, 20), np.delete(np.arange(40) / 2, 20), atol=0.6)
    assert found[20] == found[19]
    assert lines == ["clip.mkv: 1 of 40 frames lack pictures; 1 of those taken is replaced by the nearest one"]


def test_many_lost_pictures_are_an_error(tmp_path):
    with pytest.raises(CaptureError, match=r"clip\.mkv: frame \d+: 40 frames in the file, only 35 decode; copy or record it again"):
        run_frames(with_lost(tmp_path, set(range(20, 25))), tmp_path / "out")


@pytest.mark.parametrize("suffix", ["mp4", "mkv", "avi", "mov"])
def test_lost_bytes_are_told(tmp_path, suffix):
    file = encode(tmp_path / f"clip.{suffix}", levels(22), options={"bf": "0"})
    if suffix in ("mp4", "mov"):  # the index first, as for the web
        data = file.read_bytes()
        file = fast_start(file)
        assert len(file.read_bytes()) == len(data)
    data = file.read_bytes()
    assert recognise(file).facts["frames"] == 22
    file.write_bytes(data[: len(data) * 9 // 10])
    with pytest.raises(CaptureError, match=rf"clip\.{suffix}: .*cut short"):
        recognise(file)


def animation(file, count=8):
    """An animated GIF, each picture another one."""
    rng = np.random.default_rng(0)
    first, *others = [Image.fromarray(rng.integers(0, 255, (48, 64, 3), np.uint8)) for _ in range(count)]
    first.save(file, save_all=True, append_images=others, duration=100)
    return file


def test_lost_bytes_of_an_animation_are_told(tmp_path):
    file = animation(tmp_path / "clip.gif")
    data = file.read_bytes()
    assert recognise(file).facts["frames"] == 8
    file.write_bytes(data + b"\0" * 1000)  # programs append such bytes
    assert recognise(file).facts["frames"] == 8
    for kept in (len(data) * 9 // 10, len(data) - 300, len(data) - 1):
        file.write_bytes(data[:kept])
        with pytest.raises(CaptureError, match=r"clip\.gif: .*cut short; copy it again"):
            recognise(file)


@pytest.mark.parametrize("ending", [b"\x3b", b"\x3b\0"])
def test_a_byte_of_data_is_no_trailer_of_a_gif(tmp_path, ending):
    data = animation(tmp_path / "clip.gif").read_bytes()
    at = data.index(ending[:1], len(data) * 3 // 4)
    (tmp_path / "clip.gif").write_bytes(data[:at] + ending)
    with pytest.raises(CaptureError, match=r"clip\.gif: .*cut short"):
        recognise(tmp_path / "clip.gif")


def fast_start(file):
    target = file.with_name("fast" + file.suffix)
    import av

    with av.open(str(file)) as a, av.open(str(target), "w", options={"movflags": "+faststart"}) as b:
        stream = b.add_stream_from_template(a.streams.video[0])
        for packet in a.demux(video=0):
            if packet.size:
                packet.stream = stream
                b.mux(packet)
    return target.replace(file)


def test_a_trimmed_file_that_is_cut_short_is_told_too(tmp_path):
    file = edits(encode(tmp_path / "clip.mp4", levels(22), options={"bf": "0", "g": "8"}), [(0, 9)])
    data = file.read_bytes()
    at = data.index(b"moov") - 4
    mdat = data.index(b"mdat") - 4
    file.write_bytes(data[:mdat] + data[at:] + data[mdat : mdat + 600])
    with pytest.raises(CaptureError, match=r"clip\.mp4: .*cut short"):
        recognise(file)


def test_a_cover_is_no_video(tmp_path):
    file = with_cover(encode(tmp_path / "clip.mp4", levels(12)))
    assert check(file, list(range(12))) == ("clip.mp4: track 1, the cover, is not read",)


def test_the_largest_track_is_the_video(tmp_path):
    import av

    with av.open(str(tmp_path / "clip.mov"), "w") as container:
        streams = []
        for width, height in ((32, 24), SIZE):
            stream = container.add_stream("libx264", rate=10)
            stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
            streams.append(stream)
        for k in range(12):
            for stream in streams:
                picture = np.full((stream.height, stream.width, 3), 20 + 10 * k, np.uint8)
                container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        for stream in streams:
            container.mux(stream.encode())
    assert check(tmp_path / "clip.mov", list(range(12))) == ("clip.mov: track 1, 32x24, is not read",)


def test_sound_is_timed_by_the_video_and_not_by_a_cover(tmp_path):
    samples = np.random.default_rng(0).normal(0, 0.1, 32000).astype(np.float32) * (np.arange(32000) % 4000 < 400)
    write_mp4(tmp_path / "a.mp4", levels(20), 10, sound=samples)
    shutil.copy(tmp_path / "a.mp4", tmp_path / "b.mp4")
    with_cover(tmp_path / "b.mp4")
    first, second = (sound.onsets(tmp_path, name) for name in ("a.mp4", "b.mp4"))
    assert first[1] == second[1] and (first[0] == second[0]).all()
    assert survey(tmp_path, "b.mp4").seconds == survey(tmp_path, "a.mp4").seconds
