"""Monocular depth networks are loaded by transformers from safetensors alone, and run on pictures of any size."""

import builtins
import json

import numpy as np
import pytest
import torch
from e4dgs.pipeline import StageError
from e4dgs.vision.depth.align import INVERSE, SCALE
from e4dgs.vision.depth.names import is_name
from e4dgs.vision.depth.network import DepthNetwork
from tiny_depth_network import save_depth_network

PICTURE = np.random.default_rng(0).integers(0, 256, (40, 70, 3), np.uint8)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return save_depth_network(tmp_path_factory.mktemp("network"))


def test_a_network_gives_inverse_depth_of_the_size_of_the_picture(folder):
    network = DepthNetwork(folder, "cpu")
    depth = network.depth(PICTURE)
    assert network.kind == INVERSE
    assert depth.shape == (40, 70) and depth.dtype == np.float32 and (depth > 0).all() and depth.std() > 0
    assert np.array_equal(depth, DepthNetwork(folder, "cpu").depth(PICTURE)) and not np.array_equal(depth, network.depth(255 - PICTURE))


def test_its_output_is_that_of_transformers(folder):
    from transformers import AutoImageProcessor, AutoModelForDepthEstimation

    prepare, network = AutoImageProcessor.from_pretrained(folder), AutoModelForDepthEstimation.from_pretrained(folder)
    with torch.no_grad():
        small = network(**prepare(images=PICTURE, return_tensors="pt")).predicted_depth[None]
    whole = torch.nn.functional.interpolate(small, (40, 70), mode="bicubic", align_corners=False)[0, 0].numpy()
    assert np.allclose(DepthNetwork(folder, "cpu").depth(PICTURE), whole, atol=1e-4)


def test_a_config_that_says_metric_gives_depth(tmp_path):
    assert DepthNetwork(save_depth_network(tmp_path, "metric"), "cpu").kind == SCALE


def test_pickles_and_incomplete_folders_are_refused(folder, tmp_path):
    with pytest.raises(StageError, match=r"there is no config\.json in it"):
        DepthNetwork(tmp_path, "cpu")
    (tmp_path / "config.json").write_bytes((folder / "config.json").read_bytes())
    with pytest.raises(StageError, match="there are no weights in it"):
        DepthNetwork(tmp_path, "cpu")
    (tmp_path / "pytorch_model.bin").write_bytes(b"cos\nsystem\n(S'false'\ntR.")
    with pytest.raises(
        StageError, match=r"pytorch_model\.bin is a pickle, which may run code, and is not read; it needs model\.safetensors"
    ):
        DepthNetwork(tmp_path, "cpu")
    (tmp_path / "model.safetensors").write_bytes(b"no weights")
    with pytest.raises(StageError, match=r"it cannot be loaded \(.*\); give the folder of a depth network"):
        DepthNetwork(tmp_path, "cpu")


def test_code_of_a_folder_is_never_run(folder, tmp_path):
    for path in folder.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    config = json.loads((folder / "config.json").read_text())
    config |= {"model_type": "own", "auto_map": {"AutoConfig": "own.Own", "AutoModelForDepthEstimation": "own.Own"}}
    (tmp_path / "config.json").write_text(json.dumps(config))
    (tmp_path / "own.py").write_text(f"open({str(tmp_path / 'ran')!r}, 'w')\n")
    with pytest.raises(StageError, match="it cannot be loaded"):
        DepthNetwork(tmp_path, "cpu")
    assert not (tmp_path / "ran").exists()


def test_weights_that_cannot_be_fetched_are_a_message(monkeypatch):
    pytest.importorskip("transformers")
    from huggingface_hub import constants

    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", True)
    with pytest.raises(
        StageError, match=r"depth\.model=someone/something: it cannot be loaded .* copy the folder that `hf download someone"
    ):
        DepthNetwork("someone/something", "cpu")


def test_without_transformers_the_message_says_how_to_get_it(monkeypatch, tmp_path):
    real = builtins.__import__

    def missing(name, *rest):
        if name == "transformers":
            raise ImportError("No module named 'transformers'")
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", missing)
    with pytest.raises(StageError, match=r"depth\.model needs transformers .*pip install 'e4dgs\[depth\]'"):
        DepthNetwork(tmp_path, "cpu")


def test_names():
    assert all(map(is_name, ("depth-anything/Depth-Anything-V2-Small-hf", "Intel/dpt-large@main", "dpt-large")))
    assert not any(map(is_name, ("", "/etc/passwd", "../x", "a/b/c", "a b", "a/..x/..", "https://x.y/z")))
