"""Several videos of one event: cameras by name, one clock from sound or from first frames, frames at shared times."""

import os
import shutil
import struct

import numpy as np
import pytest
from e4dgs.pipeline import CaptureError
from e4dgs.stages.captures import recognise
from e4dgs.stages.captures.formats.video import decode
from e4dgs.stages.captures.formats.videos import clocks
from e4dgs.stages.captures.reading import TEST
from e4dgs.stages.captures.sound import cache as heard
from e4dgs.stages.captures.sound import onsets as sound
from e4dgs.stages.captures.video.survey import survey
from factory.writers import write_mp4
from tiny_videos import encode, levels

RATE = 16000


def grey_video(file, frames, fps, sound=None, begin=0.0):
    """Frame k is grey of a level that tells its time on the event's clock: 20 + 80 a second, up to 250."""
    pictures = (np.full((32, 48, 3), min(250, round(20 + 80 * (begin + k / fps))), np.uint8) for k in range(frames))
    write_mp4(file, pictures, fps, sound=sound)


def headers_of(root, letters):
    return {f"{letter}.mp4": survey(root, f"{letter}.mp4") for letter in letters}


def event(seconds, seed=0):
    """[N] float32: bursts of noise at random times and of random loudness, over a hum."""
    rng = np.random.default_rng(seed)
    samples = 0.02 * np.sin(np.arange(round(seconds * RATE)) * 2 * np.pi * 120 / RATE)
    for begin in np.sort(rng.uniform(0, seconds - 0.1, round(5 * seconds))):
        length = round(RATE * rng.uniform(0.02, 0.08))
        burst = rng.normal(0, rng.uniform(0.05, 0.3), length) * np.exp(-np.arange(length) / (0.3 * length))
        samples[round(begin * RATE) :][:length] += burst
    return np.clip(samples, -1, 1).astype(np.float32)


def recorded(samples, begin, seconds, gain, seed):
    """What a microphone of its own gain and noise heard from `begin` on."""
    part = samples[round(begin * RATE) : round((begin + seconds) * RATE)]
    return np.clip(gain * part + np.random.default_rng(seed).normal(0, 0.002, len(part)), -1, 1).astype(np.float32)


def test_each_video_is_a_camera_and_whole_times_are_held_out(videos_capture):
    capture = recognise(videos_capture.root)
    facts = capture.facts
    assert (facts["format"], facts["cameras"], facts["times"], facts["frames"]) == ("videos", 5, 6, 30)
    assert (facts["poses"], facts["images_in_files"], facts["splits"]) == (False, False, {"train": 25, "val": 0, "test": 5})
    assert capture.names[:2] == ("a.mp4#0", "a.mp4#1") and capture.names[-1] == "e.mp4#5"
    times = capture.time.reshape(5, 6)
    assert (times == times[0]).all() and times[0, 0] == 0 and times[0, -1] == 1
    assert ((capture.split == TEST).reshape(5, 6) == (np.arange(6) == 0)).all()
    assert facts["pairs"] == 5 * 4, "the same camera's next training frame"


def test_videos_of_one_length_are_told_by_one_count(videos_capture):
    assert "took 6 times that all of them share, of 6 frames;" in recognise(videos_capture.root).notes[0]


def test_holdout_and_thinning_count_times(videos_capture):
    assert recognise(videos_capture.root, holdout=0).facts["splits"]["test"] == 0
    capture = recognise(videos_capture.root, every=2)
    assert capture.facts["times"] == 3 and [v.taken for v in capture.videos] == [(0, 2, 4)] * 5
    assert recognise(videos_capture.root, max_frames=4).facts["times"] == 3
    assert recognise(videos_capture.root, static=True).facts["splits"] == {"train": 26, "val": 0, "test": 4}


def test_different_rates_meet_at_the_slower_ones_times(tmp_path):
    grey_video(tmp_path / "a.mp4", 30, 30)
    grey_video(tmp_path / "b.mp4", 16, 15)
    capture = recognise(tmp_path)
    assert [v.taken for v in capture.videos] == [tuple(range(0, 30, 2)), tuple(range(15))], "b ends after a, so its last frame goes"
    np.testing.assert_allclose(capture.seconds[:15], np.arange(15) / 15, atol=1e-3)
    assert (capture.seconds[:15] == capture.seconds[15:]).all()


def test_the_times_end_with_the_shortest_video(tmp_path):
    for name, frames in (("a.mp4", 12), ("b.mp4", 20), ("c.mp4", 15)):
        grey_video(tmp_path / name, frames, 25)
    capture = recognise(tmp_path)
    assert capture.facts["times"] == 12
    assert "12 times that all of them share, of 12 to 20 frames" in capture.notes[0]


def test_sound_tells_how_much_later_a_camera_began(tmp_path):
    heard = event(4.0)
    for n, (name, begin) in enumerate((("a.mp4", 0.6), ("b.mp4", 0.0), ("c.mp4", 0.84))):
        grey_video(tmp_path / name, 50, 25, recorded(heard, begin, 2.0, 0.4 + 0.3 * n, n), begin)
    shifts, how, doubt = clocks(tmp_path, headers_of(tmp_path, "abc"), None)
    assert (how, doubt) == ("aligned by their sound", ())
    np.testing.assert_allclose(shifts, [0.0, -0.6, 0.24], atol=0.008)
    capture = recognise(tmp_path)
    levels = np.array([[picture.mean() for picture in decode(tmp_path, video, 48, 32)] for video in capture.videos])
    assert np.ptp(levels, axis=0).max() < 3, "at each time all cameras show the same moment, to less than a frame (3.2 levels)"
    assert capture.facts["times"] == 29, "0.84 to 2.0 s of b's clock"


def test_frames_are_told_to_count_whatever_is_heard(tmp_path):
    heard = event(3.0)
    grey_video(tmp_path / "a.mp4", 25, 25, recorded(heard, 0.0, 1.0, 1.0, 0))
    grey_video(tmp_path / "b.mp4", 25, 25, recorded(heard, 0.4, 1.0, 1.0, 1))
    assert [v.taken for v in recognise(tmp_path, sync="frames").videos] == [tuple(range(25))] * 2


def test_unlike_sounds_align_nothing(tmp_path):
    grey_video(tmp_path / "a.mp4", 50, 25, event(2.0, seed=1))
    grey_video(tmp_path / "b.mp4", 50, 25, event(2.0, seed=2))
    unlike = "the sound of b.mp4 fits that of a.mp4 at no shift clearly better than at others"
    assert clocks(tmp_path, headers_of(tmp_path, "ab"), None) == ([0.0, 0.0], f"aligned by their first frames ({unlike})", ())
    with pytest.raises(CaptureError, match=rf"{unlike}; .* frames\.sync=frames"):
        recognise(tmp_path, sync="sound")


def test_a_metronome_tells_no_clock(tmp_path):
    """It fits as well one beat later."""
    beat = np.zeros(4 * RATE, np.float32)
    noise = np.random.default_rng(0).normal(0, 0.3, 400).astype(np.float32)
    for k in range(0, len(beat) - 400, RATE // 4):
        beat[k : k + 400] = noise
    grey_video(tmp_path / "a.mp4", 75, 25, recorded(beat, 0.0, 3.0, 1.0, 0))
    grey_video(tmp_path / "b.mp4", 75, 25, recorded(beat, 0.6, 3.0, 1.0, 1))
    first, second = (sound.onsets(tmp_path, name) for name in ("a.mp4", "b.mp4"))
    assert first is not None and second is not None and sound.offset(first, second) is None


def test_a_video_without_sound_is_named_where_sound_is_asked_for(tmp_path):
    grey_video(tmp_path / "a.mp4", 25, 25, event(1.0))
    grey_video(tmp_path / "b.mp4", 25, 25)
    assert "b.mp4 has no sound" in recognise(tmp_path).facts["why"]
    with pytest.raises(CaptureError, match=r"b\.mp4 has no sound that can be read; .* use frames\.sync=frames"):
        recognise(tmp_path, sync="sound")


def test_silence_is_no_sound(tmp_path):
    grey_video(tmp_path / "a.mp4", 25, 25, np.zeros(RATE, np.float32))
    assert sound.onsets(tmp_path, "a.mp4") is None


def test_damaged_videos_are_named(videos_capture, tmp_path):
    root = shutil.copytree(videos_capture.root, tmp_path / "cut")
    (root / "c.mp4").write_bytes((root / "c.mp4").read_bytes()[:300])
    with pytest.raises(CaptureError, match=r"^c\.mp4: "):
        recognise(root)


def test_one_frame_is_no_camera(tmp_path):
    grey_video(tmp_path / "a.mp4", 10, 25)
    grey_video(tmp_path / "b.mp4", 1, 25)
    with pytest.raises(CaptureError, match=r"b\.mp4: only one frame"):
        recognise(tmp_path)


def test_videos_that_share_no_time_are_refused(tmp_path):
    heard = event(5.0)
    grey_video(tmp_path / "a.mp4", 75, 25, recorded(heard, 0.0, 5.0, 1.0, 0))  # its sound goes on after its pictures
    grey_video(tmp_path / "b.mp4", 25, 25, recorded(heard, 3.5, 1.0, 1.0, 1))
    with pytest.raises(CaptureError, match=r"a\.mp4: shares 0 time\(s\) with b\.mp4 .* trim the videos"):
        recognise(tmp_path)


def test_poses_or_images_beside_videos_mean_another_layout(videos_capture, tmp_path):
    root = shutil.copytree(videos_capture.root, tmp_path / "rig")
    (root / "poses_bounds.npy").write_bytes(b"")
    with pytest.raises(CaptureError, match=r"cameras named cam00\.mp4"):
        recognise(root)
    assert recognise(root, format="videos").facts["cameras"] == 5


def test_sync_is_for_several_videos(video_capture):
    with pytest.raises(CaptureError, match=r"frames\.sync aligns several videos without poses, not video"):
        recognise(video_capture.root, sync="sound")


def test_long_sounds_are_heard_once(tmp_path, monkeypatch):
    """What was heard is kept for the next command, and heard again where the file has changed or what was kept is damaged."""
    (tmp_path / "videos").mkdir()
    sounds = event(3.0)
    for n, begin in enumerate((0.5, 0.0)):
        grey_video(tmp_path / "videos" / f"{n}.mp4", 50, 25, recorded(sounds, begin, 2.0, 0.5, n))
    times = []
    monkeypatch.setattr(heard.onsets, "onsets", lambda *file, listen=heard.onsets.onsets: times.append(file[1]) or listen(*file))

    def shifts():
        times.clear()
        return clocks(tmp_path / "videos", headers_of(tmp_path / "videos", "01"), "sound", tmp_path / "heard")[0]

    first = shifts()
    assert shifts() == first and len(times) == 2 and not (tmp_path / "heard").exists(), "short ones are not worth a file"
    monkeypatch.setattr(heard, "KEPT_FROM", 1.0)
    assert shifts() == first and len(times) == 2
    assert shifts() == first and not times
    kept = sorted((tmp_path / "heard").iterdir())
    assert len(kept) == 2
    (tmp_path / "videos" / "1.mp4").touch()
    shutil.move(tmp_path / "videos", tmp_path / "elsewhere")
    shutil.move(tmp_path / "elsewhere", tmp_path / "videos")
    assert shifts() == first and not times, "a time of change, or a place, says nothing"
    before = (tmp_path / "videos" / "0.mp4").stat()
    grey_video(tmp_path / "videos" / "0.mp4", 50, 25, recorded(sounds, 0.7, 2.0, 0.5, 3))
    os.utime(tmp_path / "videos" / "0.mp4", ns=(before.st_atime_ns, before.st_mtime_ns))
    assert shifts() != first and times == ["0.mp4"], "another content under the same name and time"


@pytest.mark.parametrize("damage", ["first", "digest", "values", "cut", "empty", "renamed"])
def test_what_was_heard_is_heard_again_where_a_bit_has_flipped(tmp_path, monkeypatch, damage):
    samples = np.arange(6.0), 0.25
    monkeypatch.setattr(heard, "KEPT_FROM", 0.0)
    monkeypatch.setattr(heard.onsets, "onsets", lambda root, name: times.append(name) or samples)
    (tmp_path / "a.mp4").write_bytes(b"a video")
    times: list[str] = []

    def hear():
        ((onsets, begin),) = heard.onsets_of(tmp_path, ["a.mp4"], tmp_path / "heard")
        assert onsets.tolist() == samples[0].tolist() and begin == samples[1]

    hear()
    hear()
    assert times == ["a.mp4"]
    (place,) = (tmp_path / "heard").iterdir()
    whole = place.read_bytes()
    at = {"first": 0, "digest": 40, "values": len(whole) - 1}
    if damage in at:
        spoilt = bytearray(whole)
        spoilt[at[damage]] ^= 1  # of a value's exponent: still a number, and a wrong one
        place.write_bytes(bytes(spoilt))
    elif damage == "renamed":
        (tmp_path / "a.mp4").write_bytes(b"another video")
        place.rename(place.with_stem(heard._key(tmp_path / "a.mp4")))
    else:
        place.write_bytes(whole[: 100 if damage == "cut" else 0])
    hear()
    hear()
    assert times == ["a.mp4"] * 2


def sized(file, size, frames=30, seed=0):
    """Pictures of one grey each, at 10 frames per second."""
    return encode(file, levels(frames, 2 + seed, size))


@pytest.mark.parametrize(
    "small", ["take1.mp4", "Take1_Proxy.mov", "take1-preview.mp4", "take1 lowres.mov", "take1small.mp4", "take1_copy.mkv"]
)
def test_of_two_files_of_one_clip_the_larger_picture_is_read(tmp_path, small):
    sized(tmp_path / "take1.mov", (64, 48))
    sized(tmp_path / small, (32, 24))
    capture = recognise(tmp_path)
    assert (capture.facts["cameras"], capture.facts["times"], capture.facts["width"]) == (1, 30, 64)
    assert [video.file for video in capture.videos] == ["take1.mov"]
    assert capture.notes[0].startswith(f"{small} (32x24) is left out: by its name and its frames it is the same clip as take1.mov (64x48)")
    assert small in capture.files and not any("not read" in note for note in capture.notes)
    with pytest.raises(CaptureError, match=rf"frames\.sync aligns several cameras; leave it unset: {small}"):
        recognise(tmp_path, sync="frames")


def test_small_files_of_the_clips_of_a_rig_are_no_cameras(tmp_path):
    for k, letter in enumerate("ab"):
        sized(tmp_path / f"{letter}_proxy.mp4", (32, 24), seed=k)
        sized(tmp_path / f"{letter}.mp4", (64, 48), seed=k)
    capture = recognise(tmp_path)
    assert [video.file for video in capture.videos] == ["a.mp4", "b.mp4"] and capture.facts["width"] == 64
    assert sum("is left out" in note for note in capture.notes) == 2


def test_of_two_equal_sizes_the_larger_file_is_read(tmp_path):
    sized(tmp_path / "take.mp4", (64, 48))
    (tmp_path / "take.mov").write_bytes((tmp_path / "take.mp4").read_bytes() + struct.pack(">I4s", 5008, b"free") + bytes(5000))
    assert [video.file for video in recognise(tmp_path).videos] == ["take.mov"]


def test_clips_of_unlike_length_are_cameras_whatever_their_names(tmp_path):
    for frames, cameras in ((101, 1), (102, 2)):  # 1 % of 102 frames is more than one of them, and less than two
        root = tmp_path / str(frames)
        root.mkdir()
        sized(root / "take1.mov", (64, 48), 100)
        sized(root / "take1_small.mov", (32, 24), frames)
        assert recognise(root).facts["cameras"] == cameras


@pytest.mark.parametrize(
    "other", ["shot_mask.mp4", "shot_matte.mov", "mask-shot.mp4", "shot_alpha.mp4", "shot_depth.mkv", "shot.normals.mp4"]
)
def test_a_video_of_masks_or_depth_is_no_camera(tmp_path, other):
    sized(tmp_path / "shot.mp4", (32, 24))
    sized(tmp_path / other, (32, 24), 29, seed=1)
    capture = recognise(tmp_path)
    assert [video.file for video in capture.videos] == ["shot.mp4"] and capture.facts["cameras"] == 1
    assert capture.notes[0].startswith(f"{other}: left out, since by the name it shows the ") and not any(
        "not read" in n for n in capture.notes
    )
    sized(tmp_path / "b.mp4", (32, 24), seed=2)
    assert [video.file for video in recognise(tmp_path).videos] == ["b.mp4", "shot.mp4"]
    (tmp_path / "shot.mp4").unlink()
    assert recognise(tmp_path).facts["cameras"] == 2, "of which other video it shows nothing is known"


@pytest.mark.parametrize(
    ("first", "other"),
    [("x_src", "x_vis"), ("clip", "clip_graded"), ("clip", "clip_stabilized"), ("clip-stab", "clip"), ("clip_2160p", "clip_1080p")],
)
def test_renderings_of_one_clip_are_no_cameras(tmp_path, first, other):
    sized(tmp_path / f"{first}.mp4", (32, 24) if "p" not in first[-1] else (64, 48))
    sized(tmp_path / f"{other}.mp4", (32, 24), seed=1)
    (video,) = recognise(tmp_path).videos
    assert video.file == (f"{other}.mp4" if "stab" in first else f"{first}.mp4")
