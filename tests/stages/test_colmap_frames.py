"""Rigs of COLMAP 3.12 and later: what one frame of `frames.bin` holds was taken at one time, whatever the pictures are called."""

import numpy as np
import pytest
from e4dgs.pipeline import CaptureError
from e4dgs.pipeline.keys import capture_files
from e4dgs.stages.captures import recognise
from PIL import Image

pycolmap = pytest.importorskip("pycolmap")

TIMES = 4


def own_counters(camera, time):
    return f"{'abc'[camera]}_{10 * camera + 3 * time + 7}.png"


def one_name(camera, time):
    return f"cam{camera}/{time:03d}.png"


def rig(root, name=own_counters, rigs=1, leave_out=(), text=False, backwards=False):
    """Three cameras on a rig that moves; and the true pose [4, 4], camera and time of each picture. leave_out: (camera, time) without a
    picture. rigs: how many the cameras are spread over."""
    made, truth = pycolmap.Reconstruction(), {}
    sensors = [pycolmap.sensor_t(pycolmap.SensorType.CAMERA, k + 1) for k in range(3)]
    own = [pycolmap.Rigid3d(pycolmap.Rotation3d(np.array([0.0, 0.2 * k, 0.0])), np.array([0.1 * k, 0.0, 0.0])) for k in range(3)]
    for k in range(3):
        made.add_camera(pycolmap.Camera(model="PINHOLE", width=40, height=32, params=[30, 31, 20, 16], camera_id=k + 1))
    members = [[0, 1, 2]] if rigs == 1 else [[0, 1], [2]]
    for r, cameras in enumerate(members):
        one = pycolmap.Rig()
        one.rig_id = r + 1
        one.add_ref_sensor(sensors[cameras[0]])
        for k in cameras[1:]:
            one.add_sensor(sensors[k], own[k])
        made.add_rig(one)
    for time in range(TIMES):
        for r, cameras in enumerate(members):
            frame = pycolmap.Frame()
            frame.frame_id, frame.rig_id = 1 + r + 10 * (TIMES - time if backwards else time), r + 1
            frame.rig_from_world = pycolmap.Rigid3d(pycolmap.Rotation3d(np.array([0.1 * time, 0.0, 0.0])), np.array([0.0, 0.3 * time, 2.0]))
            images = []
            for k in (k for k in cameras if (k, time) not in leave_out):
                image = pycolmap.Image(name=name(k, time), camera_id=k + 1, image_id=1 + 3 * time + k)
                image.frame_id = frame.frame_id
                frame.add_data_id(pycolmap.data_t(sensors[k], image.image_id))
                images.append(image)
                file = root / "images" / image.name
                file.parent.mkdir(parents=True, exist_ok=True)
                Image.new("RGB", (40, 32), (50 * k, 50 * time, 0)).save(file)
                pose = np.eye(4)
                pose[:3] = ((own[k] if k != cameras[0] else pycolmap.Rigid3d()) * frame.rig_from_world).matrix()
                truth[f"images/{image.name}"] = pose, k, time
            made.add_frame(frame)
            for image in images:
                made.add_image(image)
            made.register_frame(frame.frame_id)
    model = root / "sparse/0"
    model.mkdir(parents=True)
    (made.write_text if text else made.write_binary)(str(model))
    return truth


def assert_truth(capture, truth):
    assert sorted(capture.names) == sorted(truth)
    for i, name in enumerate(capture.names):
        pose, camera, time = truth[name]
        np.testing.assert_allclose(capture.cam_from_world[i], pose, atol=1e-9)
        assert (capture.camera[i], capture.time[i]) == (camera, pytest.approx(time / (TIMES - 1))), name


@pytest.mark.parametrize("text", [False, True], ids=["binary", "text"])
@pytest.mark.parametrize("name", [own_counters, one_name])
def test_pictures_of_a_frame_show_one_time(tmp_path, name, text):
    truth = rig(tmp_path, name, text=text)
    capture = recognise(tmp_path, fps=30)
    assert (capture.facts["cameras"], capture.facts["times"], capture.facts["fixed_cameras"]) == (3, TIMES, False)
    assert_truth(capture, truth)
    file = f"sparse/0/frames.{'txt' if text else 'bin'}"
    assert list(capture.notes) == [f"{file}: pictures of one frame of the rig show one time (3 cameras, 4 frames)"]
    assert file in capture.files


@pytest.mark.parametrize("backwards", [False, True])
def test_a_camera_without_a_picture_of_a_frame_moves_no_other(tmp_path, backwards):
    """Also where the numbers of frames say nothing about their order."""
    truth = rig(tmp_path, leave_out=[(1, 1), (2, 3)], backwards=backwards)
    assert_truth(recognise(tmp_path), truth)


def test_frames_of_one_picture_each_tell_nothing(tmp_path):
    rig(tmp_path, own_counters, leave_out=[(k, t) for k in (1, 2) for t in range(TIMES)])
    capture = recognise(tmp_path)
    assert (capture.facts["cameras"], capture.facts["times"]) == (1, TIMES) and not [n for n in capture.notes if "frames.bin" in n]


def test_of_several_rigs_names_tell_the_times_and_it_is_said(tmp_path):
    truth = rig(tmp_path, one_name, rigs=2)
    capture = recognise(tmp_path, fps=30)
    assert_truth(capture, truth)
    (note,) = capture.notes
    assert note.startswith("sparse/0/frames.bin is not followed: its frames are of 2 rigs") and note.endswith("the names of the pictures")


def test_frames_of_another_model_are_not_followed(tmp_path):
    rig(tmp_path / "a", one_name)
    rig(tmp_path / "b", one_name, leave_out=[(2, 3)])
    (tmp_path / "a/sparse/0/frames.bin").write_bytes((tmp_path / "b/sparse/0/frames.bin").read_bytes())
    capture = recognise(tmp_path / "a", fps=30)
    assert (capture.facts["cameras"], capture.facts["times"]) == (3, TIMES)
    (note,) = capture.notes
    assert "frames.bin is not followed: 1 image of the model (first cam2/003.png) is in none of its frames" in note


def test_frames_are_in_the_digest(tmp_path):
    rig(tmp_path)
    before = capture_files(recognise(tmp_path))
    (tmp_path / "sparse/0/frames.bin").unlink()
    assert capture_files(recognise(tmp_path)) != before


@pytest.mark.parametrize("text", [False, True], ids=["binary", "text"])
def test_damaged_frames_are_named(tmp_path, text):
    rig(tmp_path, text=text)
    file = tmp_path / f"sparse/0/frames.{'txt' if text else 'bin'}"
    file.write_bytes(file.read_bytes()[:-12])
    with pytest.raises(CaptureError, match=rf"frames\.{'txt' if text else 'bin'}: .*export it again"):
        recognise(tmp_path)
