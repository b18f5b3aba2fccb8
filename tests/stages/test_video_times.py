"""Videos whose frames are not evenly spaced in time, as phones record them."""

from fractions import Fraction

import av
import numpy as np
import pytest
from e4dgs.stages.captures import recognise
from e4dgs.stages.captures.formats.video import decode
from run_stage import run_frames

STAMPS = (0, 33, 66, 133, 166, 300, 333, 400, 433, 633)  # ms


def uneven(file, stamps=STAMPS, begin=0):
    """Frame k is grey of level 20 k; time stamps in milliseconds, frames reordered by the encoder."""
    with av.open(str(file), "w") as container:
        stream = container.add_stream("libx264", rate=30, options={"threads": "1", "bf": "2", "b_strategy": "0", "sc_threshold": "0"})
        stream.width, stream.height, stream.pix_fmt = 48, 32, "yuv420p"
        stream.time_base = stream.codec_context.time_base = Fraction(1, 1000)
        for k, stamp in enumerate(stamps):
            frame = av.VideoFrame.from_ndarray(np.full((32, 48, 3), 20 * k, np.uint8), format="rgb24").reformat(format="yuv420p")
            frame.pts, frame.time_base = begin + stamp, Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return file


@pytest.mark.parametrize("suffix", ["mp4", "mkv"])
@pytest.mark.parametrize("begin", [0, 500])
def test_time_stamps_are_the_seconds_of_frames(tmp_path, suffix, begin):
    file = uneven(tmp_path / f"clip.{suffix}", begin=begin)
    with av.open(str(file)) as container:
        order = [packet.pts for packet in container.demux(video=0) if packet.size]
    assert order != sorted(order), "the file has frames out of order, as those of cameras have"
    capture = recognise(file)
    np.testing.assert_allclose(capture.seconds, np.array(STAMPS) / 1000, atol=1e-6)
    np.testing.assert_allclose(capture.time, np.array(STAMPS) / STAMPS[-1], atol=1e-6)
    levels = [picture.mean() for picture in decode(tmp_path, capture.videos[0], 48, 32)]
    np.testing.assert_allclose(levels, 20 * np.arange(len(STAMPS)), atol=3)


def test_the_artifact_has_them_when_frames_are_thinned(tmp_path):
    frames = run_frames(uneven(tmp_path / "clip.mp4"), tmp_path / "out", every=3).artifact
    np.testing.assert_allclose(frames.read("seconds"), np.array(STAMPS[::3]) / 1000, atol=1e-6)
    np.testing.assert_allclose(frames.read("images").mean((1, 2, 3)), 20 * np.arange(0, 10, 3), atol=3)


def trimmed(file, first, last):
    """As a phone trims: every frame stays in the file, and its edit list says which to show."""
    data = bytearray(file.read_bytes())
    start = data.index(b"elst") + 12  # then: duration in ms, first time stamp
    began = int.from_bytes(data[start + 4 : start + 8], "big")
    with av.open(str(file)) as container:
        ticks = round(1 / container.streams.video[0].time_base)
    data[start : start + 4] = (STAMPS[last] - STAMPS[first] + 1).to_bytes(4, "big")
    data[start + 4 : start + 8] = (began + STAMPS[first] * ticks // 1000).to_bytes(4, "big")
    file.write_bytes(data)
    return file


@pytest.mark.parametrize(("first", "last"), [(0, 9), (0, 6), (2, 9), (3, 7)])
def test_what_an_edit_list_trims_is_not_there_and_the_file_is_whole(tmp_path, first, last):
    file = trimmed(uneven(tmp_path / "clip.mp4"), first, last)
    capture = recognise(file)
    assert capture.facts["frames"] == last - first + 1
    levels = [picture.mean() for picture in decode(tmp_path, capture.videos[0], 48, 32)]
    np.testing.assert_allclose(levels, 20 * np.arange(first, last + 1), atol=3)
