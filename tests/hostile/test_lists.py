"""Lists of scenes in YAML, and camera paths in JSON, that nobody should give."""

import json
import os
from types import SimpleNamespace

import numpy as np
import pytest
from e4dgs.pipeline import CaptureError, SettingsError
from e4dgs.workflows.batch.listing import Entry, entries_of
from e4dgs.workflows.batch.sites.cluster import read_cluster
from e4dgs.workflows.exports.camera_path import path_of_file

from .referee import at_most

BOMB = "a0: &a0 [x, x, x, x, x, x, x, x, x, x]\n" + "".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]\n" for i in range(1, 12))
MERGES = "m0: &m0 {k: 1}\n" + "".join(f"m{i}: &m{i} {{<<: [{', '.join([f'*m{i - 1}'] * 10)}]}}\n" for i in range(1, 12))
LISTS = {
    "aliases": (BOMB + "scenes: *a11\n", "aliases written out"),
    "aliases in a setting": (BOMB + "scenes: [a]\nsettings: {coarse.seed: *a11}\n", "aliases written out"),
    "merges": (MERGES + "scenes: [a]\nsettings: *m11\n", "aliases written out"),
    "an alias of itself": ("scenes: &s [*s]\n", "within itself"),
    "an alias that is not there": ("scenes: [*nowhere]\n", "not a list of scenes"),
    "deep": ("scenes: " + "[" * 100_000, "not a list of scenes"),
    "a program": ("scenes: !!python/object/apply:os.system ['true']\n", "not a list of scenes"),
    "a bad date": ("scenes: [2024-99-99]\n", "not a list of scenes"),
    "a number of 5000 digits": ("scenes: [" + "9" * 5000 + "]\n", "not a list of scenes"),
    "a sweep of 10^20": (
        "scenes: [a]\nsweep:\n" + "".join(f"  coarse.s{i}: [{', '.join(map(str, range(100)))}]\n" for i in range(10)),
        "at most",
    ),
    "a name that leads out": ("scenes: [{capture: a, name: ../../../out}]\n", "scene 1: name"),
    "an absolute name": ("scenes: [{capture: a, name: /tmp/out}]\n", "scene 1: name"),
    "a name with a line break": ('scenes: [{capture: a, name: "a\\nb"}]\n', "scene 1: name"),
    "a path with a zero": ('scenes: ["a\\0b"]\n', "not a (file name|list of scenes)"),
    "a mapping as a key": ("? {a: b}\n: c\n", "not a list of scenes"),
    "not UTF-8": (b"scenes: [\xff\xfe]\n", "not a list of scenes"),
    "control characters": (b"scenes: [\x1b\x00]\n", "not a list of scenes"),
    "empty": ("", "expected a list of captures"),
}


@pytest.mark.parametrize("case", LISTS)
def test_a_list_is_refused_at_once(case, tmp_path):
    content, words = LISTS[case]
    file = tmp_path / "list.yaml"
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    with at_most(10), pytest.raises(SettingsError, match=words):
        entries_of([str(file)], Entry("", ""))
    if case in ("aliases", "deep", "a program", "not UTF-8"):
        with at_most(10), pytest.raises(SettingsError, match="executor"):
            read_cluster(file)
    assert [f.name for f in tmp_path.iterdir()] == ["list.yaml"]


def test_a_huge_list_is_refused_at_once(tmp_path):
    (tmp_path / "list.yaml").touch()
    os.truncate(tmp_path / "list.yaml", 2**40)
    with at_most(10), pytest.raises(SettingsError, match="4 MiB"):
        entries_of([str(tmp_path / "list.yaml")], Entry("", ""))


def test_plain_aliases_are_read(tmp_path):
    (tmp_path / "list.yaml").write_text(
        "scenes:\n- {capture: a, settings: &s {coarse.seed: 1}}\n- {capture: b, settings: {<<: *s, fine.seed: 2}}\n"
    )
    first, second = entries_of([str(tmp_path / "list.yaml")], Entry("", ""))
    assert dict(first.settings) == {"coarse.seed": "1"} and dict(second.settings) == {"coarse.seed": "1", "fine.seed": "2"}


EYE = np.eye(4).tolist()
PATHS = {
    "deep": ('{"frames": ' + "[" * 100_000, "not a camera path"),
    "not UTF-8": (b'{"frames": "\xff"}', "not a camera path"),
    "a name twice": ('{"frames": [], "frames": []}', "twice"),
    "a pose of 400 digits": ([{"cam_from_world": [[10**400, 0, 0, 0], *EYE[1:]]}], "frame 0: cam_from_world"),
    "NaN": ([{"cam_from_world": [[float("nan"), 0, 0, 0], *EYE[1:]]}], "finite"),
    "far away": ([{"cam_from_world": [[1, 0, 0, 1e300], *EYE[1:]]}], "frame 0: cam_from_world"),
    "words": ([{"cam_from_world": [["1", 0, 0, 0], *EYE[1:]]}], "expected a number"),
    "sheared": ([{"cam_from_world": EYE}, {"cam_from_world": [[1, 1, 0, 0], *EYE[1:]]}], "frame 1: cam_from_world: .* not rigid"),
    "mirrored": ([{"transform_matrix": np.diag([-1.0, 1, 1, 1]).tolist()}], "mirrors"),
    "a last row": ([{"cam_from_world": [*EYE[:3], [1, 0, 0, 1]]}], "last row"),
    "a lens of 1e300": ([{"cam_from_world": EYE, "K": [[1e300, 0, 1], [0, 1, 1], [0, 0, 1]]}], "frame 0: K"),
    "a lens of nothing": ([{"cam_from_world": EYE, "K": [[0, 0, 1], [0, 1, 1], [0, 0, 1]]}], "positive"),
    "a time of 400 digits": ([{"cam_from_world": EYE, "time": 10**400}], "frame 0: time"),
    "a time that is true": ([{"cam_from_world": EYE, "time": True}], "frame 0: time"),
    "too many": ([{}] * 100_001, "1 to 100000"),
}


@pytest.mark.parametrize("case", PATHS)
def test_a_camera_path_is_refused_at_once(case, tmp_path):
    content, words = PATHS[case]
    file = tmp_path / "path.json"
    text = json.dumps({"frames": content}) if isinstance(content, list) else content
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    frames = SimpleNamespace(K=np.eye(3)[None], train=np.array([0]), origin=None, width=64, height=48)
    with at_most(10), pytest.raises(CaptureError, match=words) as caught:
        path_of_file(file, frames)
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 1100
