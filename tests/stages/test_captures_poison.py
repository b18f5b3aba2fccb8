"""Any value in a camera file may be poison: recognition ends in a capture of finite numbers or in one `CaptureError`."""

import json
import shutil

import numpy as np
import pytest
from e4dgs.pipeline import CaptureError
from e4dgs.stages.captures import recognise

NUMBERS = [0, -1, 1e-320, 1e308, -1e308, 10**400, float("nan"), float("inf")]
POISON = [None, True, *NUMBERS, "", "x", "../x", "/x", "\0", "\ud800", [], [1], [[]], {}, {"a": 1}]


def slots(node, path=()):
    """Paths of every value inside a JSON document."""
    children = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    for key, value in children:
        yield (*path, key)
        yield from slots(value, (*path, key))


def put(document, path, value):
    node = document
    for key in path[:-1]:
        node = node[key]
    node[path[-1]] = value


@pytest.mark.parametrize(
    ("fixture", "file"),
    [
        ("dnerf_capture", "transforms_train.json"),
        ("nerfstudio_capture", "transforms.json"),
        ("panoptic_capture", "train_meta.json"),
        ("nerfies_capture", "camera/0_000003.json"),
    ],
)
def test_poisoned_json(request, tmp_path, fixture, file):
    root = shutil.copytree(request.getfixturevalue(fixture).root, tmp_path / "capture")
    original = (root / file).read_text()
    # Every field of the head and of one frame or camera; the others are read by the same code.
    places = [p for p in slots(json.loads(original)) if all(not isinstance(k, int) or k in (0, 1, 3) for k in p)]
    rng = np.random.default_rng(0)
    refused = 0
    for number in range(150):
        document = json.loads(original)
        place, value = places[rng.integers(len(places))], POISON[number % len(POISON)]
        put(document, place, value)
        (root / file).write_text(json.dumps(document))
        try:
            capture = recognise(root)
        except CaptureError as error:
            refused += 1
            assert "\n" not in str(error) and len(str(error)) < 1000, (place, value)
            continue
        for array in (capture.K, capture.cam_from_world, capture.distortion, capture.time, capture.seconds):
            assert np.isfinite(array).all(), (place, value)
        assert capture.time.min() >= 0 and capture.time.max() <= 1, (place, value)
    assert refused > 75, "most of the values are harmful"
