"""The published weights of LPIPS: heads from the files of the package `lpips`, and the trunk from torch's cache of torchvision's weights.

Neither package is imported: a torchvision that was built for another torch cannot be. Files are read as plain tensors, so that nothing
in them is run.
"""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

import torch
from torch import Tensor

from .lpips import Lpips, Net, expected_shapes

INSTALL = "pip install 'e4dgs[lpips]'"
HEADS = 5
WAIT = 20.0  # s without an answer after which the download is given up: measuring must not hang without a network


@dataclass(frozen=True)
class Trunk:
    """Where torchvision publishes a trunk. The end of the name is the beginning of the file's SHA-256, which the download checks."""

    file: str

    @property
    def url(self) -> str:
        return f"https://download.pytorch.org/models/{self.file}"

    @property
    def cached(self) -> Path:
        """Where torch keeps it once it has been downloaded, by whichever program."""
        return Path(torch.hub.get_dir()) / "checkpoints" / self.file


TRUNKS: dict[Net, Trunk] = {"alex": Trunk("alexnet-owt-7be5be79.pth"), "vgg": Trunk("vgg16-397923af.pth")}


class Unavailable(Exception):
    """Published weights are not to be had here. The message says why and what to do."""


def published_lpips(net: Net) -> Lpips:
    """LPIPS with its published weights. The trunk is downloaded once, to torch's cache. Raises `Unavailable`."""
    heads = heads_file(net)
    trunk = TRUNKS[net]
    try:
        state = {f"lin{k}.weight": value for k, value in enumerate(_heads(heads))}
        with _waiting(WAIT):
            found = torch.hub.load_state_dict_from_url(trunk.url, map_location="cpu", progress=False, check_hash=True, weights_only=True)
        return Lpips(state | {name: found[name] for name in expected_shapes(net) if name in found}, net)
    except OSError as error:  # no network, or no room in the cache
        raise Unavailable(f"torchvision's {trunk.file} cannot be fetched ({error}); put it from {trunk.url} into {trunk.cached}") from error
    except Exception as error:  # cut short, or another file: each reader raises its own errors
        raise Unavailable(f"the published weights cannot be read ({error}); remove {trunk.cached} and {INSTALL} again") from error


def heads_file(net: Net) -> Path:
    """The file of the installed package `lpips` with the heads of ``net``. Raises `Unavailable`."""
    try:
        path = Path(str(metadata.distribution("lpips").locate_file(f"lpips/weights/v0.1/{net}.pth")))
    except metadata.PackageNotFoundError:
        raise Unavailable(f"no weights: {INSTALL} brings the published ones") from None
    if not path.is_file():
        raise Unavailable(f"the installed lpips has no {path.name}; {INSTALL} again")
    return path


def what_is_there(net: Net = "alex") -> tuple[bool, str]:
    """Whether LPIPS can be measured without a download, and what there is or is missing, for people. Downloads nothing."""
    try:
        heads_file(net)
    except Unavailable as error:
        return False, str(error)
    cached = TRUNKS[net].cached
    if cached.is_file():
        return True, f"published weights ({net}), trunk in {cached}"
    return False, f"the heads are there; {cached.name} is downloaded to {cached.parent} when it is first needed"


def _heads(path: Path) -> list[Tensor]:
    stored = torch.load(path, map_location="cpu", weights_only=True)
    return [stored[f"lin{k}.model.1.weight"] for k in range(HEADS)]


@contextmanager
def _waiting(seconds: float) -> Iterator[None]:
    """Connections that are opened meanwhile give up after ``seconds`` without an answer."""
    before = socket.getdefaulttimeout()
    socket.setdefaulttimeout(seconds)
    try:
        yield
    finally:
        socket.setdefaulttimeout(before)
