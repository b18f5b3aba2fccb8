"""Clocks from the timecodes that cameras write into their videos: what a code says, and when it aligns videos."""

import av
import numpy as np
import pytest
from e4dgs.pipeline import CaptureError
from e4dgs.stages.captures import recognise
from e4dgs.stages.captures.formats.videos import clocks
from e4dgs.stages.captures.video.survey import survey
from e4dgs.stages.captures.video.timecode import apart, seconds_of, shifts
from factory.writers import write_mp4

NTSC = 30000 / 1001


@pytest.mark.parametrize(
    ("code", "fps", "seconds"),
    [
        ("00:00:00:00", 25, 0),
        ("01:02:03:12", 25, 3723.48),
        ("23:59:59:24", 25, 86399.96),
        ("10:00:00:00", NTSC, 36036.0),  # counts 30 frames as a second
        ("10:00:00;00", NTSC, 35999.964),  # keeps up with the clock
        ("00:01:00;02", NTSC, 1800 / NTSC),  # follows 00:00:59;29
        ("00:10:00;00", NTSC, 17982 / NTSC),
        ("00:01:00;04", 2 * NTSC, 3600 / (2 * NTSC)),
        ("00:00:01;00", 25, 1.0),  # 25 frames a second leave nothing out
    ],
)
def test_what_a_code_says(code, fps, seconds):
    assert seconds_of(code, fps)[0] == pytest.approx(seconds, abs=1e-6)


@pytest.mark.parametrize(
    ("code", "fps"),
    [
        *(("24:00:00:00", 25), ("00:60:00:00", 25), ("00:00:00:25", 25), ("1:00:00:00", 25), ("", 25), ("x" * 1000, 25)),
        *(("00:00:00:00", 120), ("00:00:00:00", 0.5), ("00:00:00:00:00", 25)),
    ],
)
def test_what_is_no_code_of_the_rate(code, fps):
    assert seconds_of(code, fps) is None


def test_codes_align_across_midnight_and_rates():
    codes = ["23:59:59:20", "00:00:00:05", "23:59:58:00"]
    assert shifts(codes, [25, 25, 50], [5, 5, 5]) == pytest.approx([0.0, 0.4, -1.8])


@pytest.mark.parametrize(
    ("codes", "rates"),
    [
        (["10:00:00:00", None], [25, 25]),
        (["10:00:00:00", "10:00:00:00"], [25, None]),
        (["10:00:00:00", "10:00:05:00"], [25, 25]),  # the first has ended
        (["10:00:00:00", "10:00:00:00"], [25, NTSC]),  # seconds of unequal length
        (["10:00:00:00", "10:00:99:00"], [25, 25]),
    ],
    ids=["none", "no rate", "apart", "kinds of seconds", "no code"],
)
def test_codes_that_align_nothing(codes, rates):
    assert shifts(codes, rates, [5, 5]) is None


def coded(file, code, frames=50, sound=None):
    """25 frames per second of growing grey, with a timecode track as cameras write it."""
    plain = file.with_suffix(".plain.mp4")
    write_mp4(plain, (np.full((32, 48, 3), 20 + 4 * k, np.uint8) for k in range(frames)), 25, sound=sound)
    with av.open(str(plain)) as old, av.open(str(file), "w") as new:
        copies = {stream: new.add_stream_from_template(stream) for stream in old.streams}
        copies[old.streams.video[0]].metadata["timecode"] = code
        for packet in old.demux():
            if packet.dts is not None:
                packet.stream = copies[packet.stream]
                new.mux(packet)
    plain.unlink()


def test_a_recorded_track_aligns_videos_without_sound(tmp_path):
    coded(tmp_path / "a.mp4", "09:59:59:20")
    coded(tmp_path / "b.mov", "10:00:00:10")
    assert survey(tmp_path, "b.mov").timecode == "10:00:00:10"
    capture = recognise(tmp_path)
    assert "aligned by their timecodes (b.mov +0.600 s)" in capture.notes[0]
    assert [video.taken[0] for video in capture.videos] == [15, 0]
    assert [video.taken[0] for video in recognise(tmp_path, sync="frames").videos] == [0, 0]


def test_sound_goes_before_timecodes_and_says_where_they_differ(tmp_path, monkeypatch):
    from e4dgs.stages.captures.formats import videos

    for name, code in (("a.mp4", "10:00:00:00"), ("b.mp4", "10:00:00:10")):
        coded(tmp_path / name, code)
    headers = {name: survey(tmp_path, name) for name in ("a.mp4", "b.mp4")}
    for heard, doubts in ((0.4, 0), (0.4 + 0.059, 0), (0.4 + 0.061, 1)):  # one frame and a half is 0.06 s
        monkeypatch.setattr(videos, "_by_sound", lambda *of, heard=heard: [0.0, heard])
        found, how, doubt = clocks(tmp_path, headers, None)
        assert (found, how, len(doubt)) == ([0.0, heard], "aligned by their sound", doubts)
        assert clocks(tmp_path, headers, "timecode")[:2] == ([0.0, pytest.approx(0.4)], "aligned by their timecodes")
    assert "0.061 s elsewhere; frames.sync=timecode" in doubt[0]


def test_codes_that_are_asked_for_and_missing_are_named(tmp_path):
    coded(tmp_path / "a.mp4", "10:00:00:00")
    coded(tmp_path / "b.mp4", "11:00:00:00")
    with pytest.raises(CaptureError, match=r"a\.mp4 10:00:00:00, b\.mp4 11:00:00:00.* leave frames\.sync unset"):
        recognise(tmp_path, sync="timecode")
    assert "aligned by their first frames" in recognise(tmp_path).facts["why"]


def test_what_the_codes_of_one_recording_say():
    codes, lengths = ["10:00:02:00", "10:00:00:00", "10:00:01:00"], [2, 2, 2]
    assert apart(codes, [25] * 3, lengths) == (1, 0), "the first to end, and the last to begin"
    assert apart(codes, [25] * 3, [2, 2.04, 2]) is None and shifts(codes, [25] * 3, [2, 2.04, 2]) == [0, -2, -1]
    assert apart(["10:00:00:00", None], [25, 25], [2, 2]) is None, "nothing is known"


def test_parts_of_one_recording_are_told_and_still_read(tmp_path):
    coded(tmp_path / "DJI_0001.MP4", "10:00:00:00")
    coded(tmp_path / "DJI_0002.MP4", "10:00:02:00")
    capture = recognise(tmp_path)
    told = "by their timecodes DJI_0002.MP4 (10:00:02:00) follows DJI_0001.MP4 (10:00:00:00), so they may be parts of one recording"
    assert capture.facts["cameras"] == 2 and any(told in note and "-f concat" in note for note in capture.notes)
    for meant in ({"format": "videos"}, {"sync": "frames"}):
        assert not any("follows" in note for note in recognise(tmp_path, **meant).notes)


@pytest.mark.parametrize(
    ("first", "second"),
    [
        *(("GX010034.MP4", "GX020034.MP4"), ("gh010034.mp4", "gh020034.mp4"), ("GL010034.mp4", "GL030034.mp4")),
        *(("GOPR0034.MP4", "GP010034.MP4"), ("GP010034.MP4", "GP020034.MP4")),
    ],
)
def test_chapters_are_no_cameras(tmp_path, first, second):
    for k, name in enumerate((first, second)):
        coded(tmp_path / name, f"10:00:00:0{k}", frames=8)
    with pytest.raises(CaptureError, match=f"{first}, {second} are chapters of one recording.* -c copy all.mp4.*--format videos reads"):
        recognise(tmp_path)
    for meant in ({"format": "videos"}, {"sync": "frames"}):
        assert recognise(tmp_path, **meant).facts["cameras"] == 2


@pytest.mark.parametrize("second", ["GX010035.MP4", "GH020034.MP4", "GX020034 b.MP4"])
def test_names_of_other_recordings_are_cameras(tmp_path, second):
    for name, level in (("GX010034.MP4", 0), (second, 1)):
        coded(tmp_path / name, f"10:00:00:0{level}", frames=8)
    assert recognise(tmp_path).facts["cameras"] == 2


def dated(file, created, seconds=8, size=(48, 32), rate=5):
    """Grey pictures in a file that says when it was made."""
    plain = file.with_suffix(".plain.mp4")
    write_mp4(plain, (np.full((size[1], size[0], 3), 20 + 2 * k, np.uint8) for k in range(rate * seconds)), rate)
    with av.open(str(plain)) as old, av.open(str(file), "w") as new:
        copy = new.add_stream_from_template(old.streams.video[0])
        if created:
            new.metadata["creation_time"] = f"{created}.000000Z"
        for packet in old.demux():
            if packet.dts is not None:
                packet.stream = copy
                new.mux(packet)
    plain.unlink()


@pytest.mark.parametrize("dates", [("2024-05-01T23:59:55", "2024-05-02T00:00:04"), ("2024-05-02T00:00:04", "2024-05-02T00:00:09")])
def test_parts_that_follow_by_their_dates_are_no_cameras(tmp_path, dates):
    """Also where the dates are those of the ends, as some cameras write them, and where the last part is short."""
    for name, created, seconds in zip(("DJI_0001.MP4", "DJI_0002.MP4"), dates, (8, 5), strict=True):
        dated(tmp_path / name, created, seconds)
    with pytest.raises(
        CaptureError, match=r"DJI_0001.MP4, DJI_0002.MP4 are parts of one recording.* -c copy all.mp4.*--format videos reads"
    ):
        recognise(tmp_path)
    for meant in ({"format": "videos"}, {"sync": "frames"}):
        capture = recognise(tmp_path, **meant)
        assert capture.facts["cameras"] == 2 and not any("follows" in note for note in capture.notes)


def test_clips_that_are_apart_by_their_dates_are_told_and_still_read(tmp_path):
    dated(tmp_path / "a.mp4", "2024-05-01T10:30:00")
    dated(tmp_path / "b.mp4", "2024-05-01T10:00:00")
    capture = recognise(tmp_path)
    told = "by the dates in the files a.mp4 (2024-05-01 10:30:00) follows b.mp4 (2024-05-01 10:00:00), so they may be parts"
    assert capture.facts["cameras"] == 2 and any(told in note for note in capture.notes)


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ({"created": "2024-05-01T10:00:00"}, {"created": "2024-05-01T10:00:03"}),
        ({"created": "2024-05-01T10:00:00"}, {"created": None}),
        ({"created": "1904-01-01T00:00:00"}, {"created": "1904-01-01T00:00:08"}),
        ({"created": "2024-05-01T10:00:00"}, {"created": "2024-05-01T10:00:08", "size": (64, 32)}),
        ({"created": "2024-05-01T10:00:00"}, {"created": "2024-05-01T10:00:08", "rate": 10}),
        ({"created": "2024-05-01T10:00:00", "seconds": 3}, {"created": "2024-05-01T10:00:03", "seconds": 3}),
        ({"created": "2024-05-01T10:00:05", "seconds": 5}, {"created": "2024-05-01T10:00:20", "seconds": 20}),
    ],
    ids=["overlap", "no date", "clock not set", "size", "rate", "short", "ends of two cameras at one time"],
)
def test_dates_that_say_nothing_leave_cameras(tmp_path, first, second):
    dated(tmp_path / "a.mp4", **first)
    dated(tmp_path / "b.mp4", **second)
    capture = recognise(tmp_path)
    assert capture.facts["cameras"] == 2 and not any("follows" in note for note in capture.notes)


@pytest.mark.parametrize(("second", "apart"), [("2024-05-01T10:00:12", 9), ("2024-05-01T10:00:05", None), ("2024-05-01T10:00:01", None)])
def test_first_frames_of_other_moments_are_doubted(tmp_path, second, apart):
    """The second video is 3 s longer; where the dates are those of the ends, so much less lies between the starts."""
    dated(tmp_path / "a.mp4", "2024-05-01T10:00:00", 8)
    dated(tmp_path / "b.mp4", second, 11, size=(32, 24))
    told = [note for note in recognise(tmp_path).notes if "apart" in note]
    assert bool(told) == (apart is not None) and all(f"they begin up to {apart} s apart" in note for note in told)
    assert not any("apart" in note for note in recognise(tmp_path, sync="frames").notes)
