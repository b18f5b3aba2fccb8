"""What the web player is given of a model and its capture: bounded size, a poster, cameras, and the stated loss."""

import io

import numpy as np
import pytest
import torch
from e4dgs.scene.formats.web.container import header_of
from e4dgs.scene.formats.web.scene import WebScene
from e4dgs.stages.exports.web import export_web, light_web
from e4dgs.stages.shared.posed_frameset import PosedFrameSet
from made_models import made
from PIL import Image
from run_stage import run_frames


@pytest.fixture(scope="module")
def frames(dnerf_capture, tmp_path_factory) -> PosedFrameSet:
    return PosedFrameSet(run_frames(dnerf_capture.root, tmp_path_factory.mktemp("web")).artifact, dnerf_capture.root)


def test_the_export_has_the_captures_cameras_a_poster_and_its_loss(frames):
    model, parts = made("lives"), []
    done = export_web(model, frames, 12, parts.append)
    assert parts == [1, 1, 1] and done.loss.psnr > 40 and "dB from the model over" in str(done)
    header, _ = header_of(done.data)
    assert len(header["cameras"]) == len(frames.train) and header["motion"] == "lives"
    first = np.array(header["cameras"][0]["cam_from_world"]).reshape(4, 4)
    assert np.abs(frames.cam_from_world[frames.train] - first).max((1, 2)).min() < 1e-6
    assert np.linalg.norm(header["up"]) == pytest.approx(1)
    picture = Image.open(io.BytesIO(done.poster))
    assert picture.format == "JPEG" and picture.size == (frames.width, frames.height)
    assert model.device == torch.device("cpu")


def test_a_copy_for_the_report_has_fewer_bands_where_room_is_short(frames):
    model = made("lives")
    whole, poster = light_web(model, frames, 12, 10**8)
    assert WebScene.from_bytes(whole).header["sh_degree"] == 2 and poster[:2] == b"\xff\xd8"
    small, _ = light_web(model, frames, 12, len(whole) * 3 // 4)
    assert len(small) <= len(whole) * 3 // 4 and WebScene.from_bytes(small).header["sh_degree"] < 2
    assert light_web(model, frames, 12, 1000) is None
