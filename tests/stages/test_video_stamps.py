"""Only bad time stamps are replaced, between their good neighbours."""

from fractions import Fraction

import numpy as np
import pytest
from e4dgs.pipeline import CaptureError
from e4dgs.stages.captures import recognise
from e4dgs.stages.captures.formats.video import decode, survey
from e4dgs.stages.captures.video.rates import rig_told
from e4dgs.stages.captures.video.times import WRAP, frame_rate, picture_times
from tiny_videos import encode, levels, remux

PHONE = np.cumsum([0] + [433 if k in (6, 13) else 33 for k in range(19)]).tolist()  # ms


def repaired(stamps, **changed):
    stamps = list(stamps)
    for place, value in changed.items():
        stamps[int(place[1:])] = value
    return picture_times(stamps, False)


def test_good_stamps_stay():
    times = picture_times(PHONE, False)
    assert times.ticks.tolist() == PHONE and times.repaired == 0


@pytest.mark.parametrize(
    ("changed", "bad"),
    [
        ({"_5": PHONE[4]}, [5]),
        ({"_5": None}, [5]),
        ({"_0": None}, [0]),
        ({"_19": None}, [19]),
        ({"_5": PHONE[2]}, [5]),
        ({"_5": 10**9}, [5]),
        ({"_5": -(10**9)}, [5]),
        ({"_5": PHONE[4], "_10": None, "_11": 0}, [5, 10, 11]),
    ],
    ids=["doubled", "missing", "first missing", "last missing", "backwards", "far ahead", "far behind", "several"],
)
def test_bad_stamps_are_put_between_their_neighbours(changed, bad):
    times = repaired(PHONE, **changed)
    good = [k for k in range(20) if k not in bad]
    assert times.ticks[good].tolist() == [PHONE[k] for k in good] and times.repaired == len(bad)
    np.testing.assert_allclose(times.ticks[bad], [PHONE[k] for k in bad], atol=1)
    assert (np.diff(times.ticks) > 0).all()


def test_of_two_equal_stamps_the_one_that_fits_stays():
    assert picture_times([0, 10, 20, 20, 40, 50], False).ticks.tolist() == [0, 10, 20, 30, 40, 50]
    assert picture_times([0, 10, 30, 30, 40, 50], False).ticks.tolist() == [0, 10, 20, 30, 40, 50]


def test_a_clock_that_wraps_or_begins_again_is_continued():
    steps = np.arange(60) * 3000
    wrapped = [int(v) % WRAP for v in steps + WRAP - 60000]
    times = picture_times(wrapped, False)
    assert (np.diff(times.ticks) == 3000).all() and (times.jumps, times.repaired) == (1, 0)
    times = picture_times([*steps, *steps], False)
    assert (np.diff(times.ticks) == 3000).all() and (times.jumps, times.repaired) == (1, 0)


def test_pictures_stored_in_another_order_keep_their_times():
    order = [0, 3, 1, 2, 6, 4, 5, 9, 7, 8, 12, 10, 11]
    stamps = [10 * k for k in order]
    assert picture_times(stamps, True).raw == tuple(sorted(stamps))
    for damage in (lambda s: s.__setitem__(4, 40), lambda s: s.__setitem__(4, None)):
        broken = list(stamps)
        damage(broken)  # picture 6 has the stamp of picture 4, or none
        times = picture_times(broken, True)
        assert times.ticks.tolist() == [10.0 * k for k in range(13)] and times.repaired == 1
        assert [times.raw.index(stamp) for stamp in broken] == [order[k] if k != 4 or broken[4] is None else 4 for k in range(13)]


def test_a_clock_that_begins_again_is_continued_in_any_order():
    """As in transport streams that were put together; pictures are stored in another order."""
    order = [0] + [k + d for k in range(1, 61, 3) for d in (2, 0, 1)]
    stamps = [6000 * k for k in order]
    times = picture_times(stamps * 2, True)
    assert times.ticks.tolist() == [6000.0 * k for k in range(122)] and (times.jumps, times.repaired) == (1, 0)
    assert times.raw == tuple(sorted(stamps)) * 2


def test_many_bad_stamps_are_placed_in_one_pass():
    """Many doubled stamps must not take hours."""
    stamps = [10 * (k - k % 2) for k in range(60_000)]
    for reordered in (False, True):
        times = picture_times(stamps, reordered)
        assert times.repaired == 30_000 and (np.diff(times.ticks) > 0).all()


def test_streams_that_hide_their_reordering_are_sorted():
    order = [0, 3, 1, 2, 6, 4, 5, 9, 7, 8, 12, 10, 11]
    assert picture_times([10 * k for k in order], False).ticks.tolist() == [10.0 * k for k in range(13)]


def test_no_stamps_at_all():
    assert picture_times([None] * 5, True).untimed
    assert picture_times([7] * 20, False).untimed and picture_times([7] * 20, False).ticks.tolist() == list(range(20))


@pytest.mark.parametrize("stated", [1000.0, 90000.0, 600.0, None])
def test_a_rate_that_contradicts_the_times_is_not_believed(stated):
    seconds = [k / 25 for k in range(50)]
    assert frame_rate(seconds, stated) == pytest.approx(25)
    assert frame_rate(seconds, 25.0) == 25.0


def doubled(file, place=11):
    """A phone whose rate varies; two neighbours have one stamp."""
    source = encode(file.with_name(f"source-{file.stem}.mkv"), levels(20), stamps=PHONE, base=Fraction(1, 1000), options={"bf": "0"})

    def change(packets):
        packets[place].pts = packets[place].dts = packets[place - 1].pts
        return packets

    remux(source, file, change)
    source.unlink()
    return file


def test_one_doubled_stamp_of_a_file_changes_one_time(tmp_path):
    capture = recognise(doubled(tmp_path / "clip.mkv"))
    np.testing.assert_allclose(capture.seconds * 1000, PHONE, atol=1)
    assert capture.notes[1:] == (
        "clip.mkv: 1 of 20 time stamps are doubled, missing or out of order; they are placed between their neighbours",
    )
    shown = [p.mean() for p in decode(tmp_path, capture.videos[0], 64, 48)]
    np.testing.assert_allclose(shown, [20 + 10 * k for k in range(20)], atol=2)
    assert survey(tmp_path, "clip.mkv").fps == pytest.approx(19 / (PHONE[-1] / 1000), rel=1e-3)


def test_a_doubled_stamp_costs_a_folder_of_videos_no_time(tmp_path):
    doubled(tmp_path / "a.mkv")
    encode(tmp_path / "b.mkv", levels(20), stamps=PHONE, base=Fraction(1, 1000), options={"bf": "0"})
    capture = recognise(tmp_path)
    assert capture.facts["times"] == 20 and [v.taken for v in capture.videos] == [tuple(range(20))] * 2
    assert sum("time stamps" in note for note in capture.notes) == 1


@pytest.mark.parametrize(
    ("suffix", "codec", "timing", "rate"), [("h264", "libx264", 1, 50), ("hevc", "libx265", 1, 50), ("hevc", "libx265", 0, 30)]
)
def test_raw_streams_say_that_their_times_are_assumed_at_the_rate_of_their_header(tmp_path, suffix, codec, timing, rate):
    options = {"x265-params": f"log-level=none:pools=1:vui-timing-info={timing}"} if codec == "libx265" else None
    capture = recognise(encode(tmp_path / f"clip.{suffix}", levels(8), codec, options, rate=50))
    assert any(f"no time stamps that can be used: frames count as 1/{rate} s apart" in note for note in capture.notes)
    assert capture.facts["frames"] == 8 and capture.seconds[-1] == pytest.approx(7 / rate)


def test_raw_streams_in_a_folder_are_the_videos_of_a_rig(tmp_path):
    for k, name in enumerate(("cam0.h264", "cam1.264", "cam2.H264")):
        encode(tmp_path / name, levels(8 + k), "libx264", None, rate=50)
    facts = recognise(tmp_path).facts
    assert (facts["format"], facts["cameras"], facts["frames"]) == ("videos", 3, 24)


def test_a_rate_for_frames_with_times_is_refused(video_capture, videos_capture, n3v_capture):
    for capture, kind in ((video_capture, "video"), (videos_capture, "videos"), (n3v_capture, "n3v")):
        with pytest.raises(CaptureError, match=rf"frames\.fps is for pictures without times, but the layout {kind} has its own; leave it"):
            recognise(capture.root, fps=25)


def test_cameras_of_a_rig_at_two_rates_are_warned_of(n3v_capture, tmp_path):
    for name, rate in (("cam00.mp4", 10), ("cam01.mp4", 20), ("cam02.mp4", 10)):
        encode(tmp_path / name, levels(8), rate=rate)
    headers = {name: survey(tmp_path, name) for name in ("cam00.mp4", "cam01.mp4", "cam02.mp4")}
    (line,) = rig_told(headers)
    assert line.startswith("cam01.mp4: 8 frames in 0.35 s, but cam00.mp4 has as many in 0.70 s; ")
    assert rig_told({name: headers[name] for name in ("cam00.mp4", "cam02.mp4")}) == ()
    assert not any("one rate" in note for note in recognise(n3v_capture.root).notes)


def test_an_hour_between_two_frames_is_spoken_of(tmp_path):
    def notes(stamps):
        encode(tmp_path / "a.mkv", [np.full((48, 64, 3), 40 * (k % 5), np.uint8) for k in range(16)], stamps=stamps, base=Fraction(1, 1000))
        return [note for note in recognise(tmp_path / "a.mkv").notes if "pass between" in note]

    (note,) = notes([33 * k + (3_600_000 if k > 7 else 0) for k in range(16)])
    assert "3600 s pass between its frames 7 and 8" in note
    assert notes([33 * k + (9_000 if k > 7 else 0) for k in range(16)]) == [], "a short pause is usual"
