"""Every case of the corpus again: failures that were found and mended, and one case of each kind of outcome."""

import json
import re
from pathlib import Path

import pytest
import torch
from rasterizer.kernels import needs_cpu

from .cases import make_case, tensors_of
from .invariants import Broken, run

CORPUS = sorted(Path(__file__).with_name("corpus").glob("*.json"))


@pytest.fixture(autouse=True)
def threads():
    """A case sets their number."""
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)


@needs_cpu
def test_cases_of_the_corpus_keep_all_invariants():
    broken, kinds = [], set()
    for path in CORPUS:
        entry = json.loads(path.read_text())
        try:
            kinds.add(run(make_case(entry["seed"], entry["index"])))
        except Exception as error:
            broken.append(f"{path.name} ({entry['kind']}): {type(error).__name__}: {error}")
    assert not broken, "\n".join(broken)
    # The corpus is worth what it reaches: where a change of cases.py moved all of it, collect it again with --collect.
    assert len(kinds) > 30, sorted(kinds)
    assert sum(kind.startswith("refused") for kind in kinds) > 6


def test_a_case_is_made_of_its_two_numbers_alone():
    for index in range(20):
        one, other = tensors_of(make_case(3, index)), tensors_of(make_case(3, index))
        assert one.keys() == other.keys()
        assert all(torch.equal(one[name].nan_to_num(), other[name].nan_to_num()) for name in one)
    names = {tuple((name, tuple(value.shape)) for name, value in tensors_of(make_case(3, index)).items()) for index in range(20)}
    assert len(names) > 15


@needs_cpu
def test_the_invariants_notice_what_they_are_for(monkeypatch):
    """Kernels that lie about one thing at a time are caught."""
    from . import invariants

    honest = invariants.rasterize

    def lying(change):
        def rasterize(*arguments, **options):
            frame = honest(*arguments, **options)
            change(frame, arguments[1])
            return frame

        return rasterize

    def scale(name, factor):
        return lambda frame, _: setattr(frame, name, getattr(frame, name) * factor)

    def leak(frame, gaussians):
        """Every opacity has a share in the colour's gradient, and none in its value."""
        if gaussians is not None:
            share = gaussians.opacities.float().nan_to_num(0, 0, 0).sum()
            frame.color = frame.color + (share - share.detach())

    def tint(frame, gaussians):
        if gaussians is not None and not all(bool(value.isfinite().all()) for value in (gaussians.means, gaussians.scales)):
            frame.color = frame.color + 1

    lies = {
        "alpha is outside": scale("alpha", 2.0),
        "depth is negative": scale("depth", -1.0),
        "is not finite": lambda frame, _: frame.color.detach().view(-1)[:1].fill_(float("nan")),
        "differs with two threads": lambda frame, _: frame.color.detach().mul_(torch.get_num_threads()),
        "bad row is visible": lambda frame, _: frame.visible_gaussians.fill_(True),
        "a bad row's is not zero": leak,
        "a bad row changes color": tint,
    }
    for message, lie in lies.items():
        monkeypatch.setattr(invariants, "rasterize", lying(lie))
        found = set()
        for index in range(60):
            try:
                run(make_case(0, index))
            except Broken as broken:
                found.add(re.sub(r"^(gaussians|convexes): ", "", str(broken)))
            except ValueError:
                pass
        assert any(message in words for words in found), (message, found)
