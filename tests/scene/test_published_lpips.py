"""The published weights of LPIPS: found, absent, not to be downloaded, and hostile. Weights are random, saved here in their layout."""

import os
from pathlib import Path
from urllib.error import URLError

import numpy as np
import pytest
import torch
from e4dgs.scene.metrics.lpips import Lpips, expected_shapes
from e4dgs.scene.metrics.published_lpips import TRUNKS, Unavailable, published_lpips, what_is_there


def install_heads(folder: Path, net: str, state: dict[str, torch.Tensor]) -> None:
    """What `pip install lpips` leaves in ``folder``, as far as it is read."""
    (folder / "lpips-0.1.4.dist-info").mkdir(parents=True)
    (folder / "lpips-0.1.4.dist-info" / "METADATA").write_text("Metadata-Version: 2.1\nName: lpips\nVersion: 0.1.4\n")
    (folder / "lpips" / "weights" / "v0.1").mkdir(parents=True)
    heads = {f"lin{k}.model.1.weight": state[f"lin{k}.weight"] for k in range(5)}
    torch.save(heads, folder / "lpips" / "weights" / "v0.1" / f"{net}.pth")


def random_state(net: str) -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    return {name: 0.05 * torch.rand(shape, generator=generator) for name, shape in expected_shapes(net).items()}


@pytest.fixture
def nothing_here(tmp_path, monkeypatch):
    """No package `lpips`, an empty cache, and no network."""

    def refused(*args, **kwargs):
        raise URLError("no network in this test")

    monkeypatch.setenv("TORCH_HOME", str(tmp_path / "torch"))
    monkeypatch.setattr(torch.hub, "download_url_to_file", refused)
    monkeypatch.syspath_prepend(str(tmp_path / "site"))
    return tmp_path / "site"


def cache_trunk(net: str, state: dict[str, torch.Tensor]) -> Path:
    """The trunk where torch keeps it, with a layer of the classifier, which is not used."""
    path = TRUNKS[net].cached
    path.parent.mkdir(parents=True)
    trunk = {name: value for name, value in state.items() if name.startswith("features.")}
    torch.save(trunk | {"classifier.6.weight": torch.zeros(2, 2)}, path)
    return path


@pytest.mark.parametrize("net", ["alex", "vgg"])
def test_heads_and_trunk_are_put_together(nothing_here, net):
    state = random_state(net)
    install_heads(nothing_here, net, state)
    cached = cache_trunk(net, state)
    rng = np.random.default_rng(0)
    image, truth = rng.random((40, 48, 3)), rng.random((40, 48, 3))
    assert published_lpips(net)(image, truth) == Lpips(state, net)(image, truth) > 0
    assert what_is_there(net) == (True, f"published weights ({net}), trunk in {cached}")


def test_without_the_package_the_reason_names_the_command(nothing_here):
    with pytest.raises(Unavailable, match=r"pip install 'e4dgs\[lpips\]'"):
        published_lpips("alex")
    there, detail = what_is_there()
    assert not there and "pip install 'e4dgs[lpips]'" in detail


def test_without_a_network_the_reason_names_the_file_and_its_place(nothing_here):
    install_heads(nothing_here, "alex", random_state("alex"))
    with pytest.raises(Unavailable, match=r"no network.*https://download.pytorch.org/models/alexnet-owt-7be5be79.pth into .*checkpoints"):
        published_lpips("alex")
    there, detail = what_is_there()
    assert not there and "downloaded to" in detail


class Bomb:
    """Creates a file when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self):
        return os.mkdir, (str(self.path),)


def test_code_in_a_file_is_not_run(nothing_here, tmp_path):
    state = random_state("alex")
    install_heads(nothing_here, "alex", state)
    trunk = cache_trunk("alex", state)
    torch.save({"features.0.weight": Bomb(tmp_path / "ran")}, trunk)
    with pytest.raises(Unavailable, match="cannot be read"):
        published_lpips("alex")
    torch.save({"lin0.model.1.weight": Bomb(tmp_path / "ran")}, nothing_here / "lpips" / "weights" / "v0.1" / "alex.pth")
    with pytest.raises(Unavailable, match="cannot be read"):
        published_lpips("alex")
    assert not (tmp_path / "ran").exists()


def test_a_trunk_of_another_network_is_refused(nothing_here):
    install_heads(nothing_here, "alex", random_state("alex"))
    cache_trunk("alex", random_state("vgg"))
    with pytest.raises(Unavailable, match=r"features\.\d+.*remove .*alexnet-owt"):
        published_lpips("alex")
