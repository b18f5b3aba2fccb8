"""The player's modules in Node: decoding, depths and sorting against Python, hostile files, the camera."""

import json
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import torch
from e4dgs.scene.formats.web.scene import WebScene
from e4dgs.stages.exports.web_scene import web_scene
from e4dgs.workflows.player import page as pages
from made_models import FRAMES, MOTIONS, camera, made

ABOUT = {"seconds": 1.0, "up": [0.0, -1.0, 0.0], "target": [0.0, 0.0, 0.0], "cameras": []}
VIEW = camera(0.7, distance=0.9)  # in the middle of things: some are behind, some across the near plane


@pytest.fixture(scope="module")
def node() -> str:
    found = shutil.which("node")
    if found is None:
        pytest.skip("needs Node: apt-get install nodejs")
    return found


def truth_of(data: bytes) -> dict:
    """What `player.test.mjs` compares: weighted sums of every array, and depths at some times."""
    scene = WebScene.from_bytes(data)
    flat = {name: values.reshape(-1) for name, values in scene.arrays.items()}
    sums = {name: [float(x @ (np.arange(len(x)) % 7 + 1)), float(x[-1]) if len(x) else 0.0] for name, x in flat.items()}
    row, near = VIEW.cam_from_world[2].double(), scene.header["near"]
    moments = []
    for time in (0.0, 0.37, 1.0):
        gaussians, convexes = scene.at(time)
        z = [float(v) for v in gaussians.means.double() @ row[:3] + row[3]]
        depth = [None if o < 1 / 255 else v for v, o in zip(z, gaussians.opacities.tolist())]
        for corners, opacity in zip(convexes.points.double() @ row[:3] + row[3], convexes.opacities.tolist()):
            drawn = bool((corners > near).any()) if scene.header["antialiased"] else bool((corners >= near).all())
            depth.append(float(corners.clamp(min=near).mean()) if drawn and opacity >= 1 / 255 else None)
        moments.append({"time": time, "depth": depth})
    return {"sums": sums, "row": row.tolist(), "moments": moments}


def damaged(data: bytes) -> dict[str, bytes]:
    return {
        "empty": b"",
        "picture": b"\x89PNG" + data[4:],
        "cut-early": data[:40],
        "cut-late": data[:-30],
        "flipped": data[:-300] + bytes([data[-300] ^ 255]) + data[-299:],
        "large": data.replace(b'"planes":2', b'"planes":9', 1),
        "shapeless": data.replace(b'"shape":[', b'"shape":[9', 1),
        "dancing": data.replace(b'"motion":"nodes"', b'"motion":"dance"', 1),
        "nowhere": data.replace(b'"nodes":', b'"nodes":1', 1),
        "endless": data.replace(b'"low":[', b'"low":[1e999,', 1),
    }


def test_modules_pass_their_tests_in_node(node, tmp_path):
    scripts, scenes = tmp_path / "scripts", tmp_path / "scenes"
    shutil.copytree(pages.FOLDER / "scripts", scripts)
    (scripts / "package.json").write_text('{"type": "module"}')
    scenes.mkdir()
    for motion in MOTIONS:
        for antialiased in (True, False):
            with torch.no_grad():
                model = made(motion, degree=1, gaussians=120, convexes=40, antialiased=antialiased)
            scene, steps = web_scene(model, FRAMES, 0.02, ABOUT)
            data = scene.to_bytes(steps)
            (scenes / f"{motion}-{antialiased}.e4dw").write_bytes(data)
            (scenes / f"{motion}-{antialiased}.json").write_text(json.dumps(truth_of(data)))
            if (motion, antialiased) == ("nodes", True):
                for name, bad in damaged(data).items():
                    (scenes / f"{name}.bad").write_bytes(bad)
    test = Path(__file__).with_name("player.test.mjs")
    variables = {**os.environ, "SCRIPTS": str(scripts), "SCENES": str(scenes)}
    done = subprocess.run([node, "--test", str(test)], env=variables, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stdout[-4000:]


@pytest.mark.parametrize("entry", ["main", "worker"])
def test_the_bundle_is_a_script_that_parses(node, entry, tmp_path):
    file = tmp_path / "bundle.js"
    file.write_text(pages.bundle(entry, "start"))
    done = subprocess.run([node, "--check", str(file)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_every_module_keeps_to_the_form_that_is_bundled():
    for path in (pages.FOLDER / "scripts").glob("*.js"):
        text = path.read_text()
        assert len(text.splitlines()) <= 300, path.name
        assert text.count("\nimport ") + text.startswith("import ") == len(pages.IMPORT.findall(text)), path.name
        assert text.count("\nexport ") == len(pages.EXPORT.findall(text)), path.name
        for word in ("eval(", "new Function", "innerHTML", "http:", "https:", "</script"):
            assert word not in text, f"{path.name} has {word}"


def test_pages_are_alike_and_their_texts_are_escaped():
    data = b"E4DW"
    text = pages.page('<b>"quoted" & more', data, b"jpeg", (0.0, 0.5, 1.0))
    assert text == pages.page('<b>"quoted" & more', data, b"jpeg", (0.0, 0.5, 1.0))
    assert "<title>&lt;b&gt;&#34;quoted&#34; &amp; more</title>" in text and "#0080ff" in text
    assert "connect-src" not in text and "unsafe" not in text.split("</head>")[0]
    apart = pages.page("x", "scene.e4dw", None, (0, 0, 0))
    assert "connect-src &#39;self&#39;" in apart and 'data-scene="scene.e4dw"' in apart and 'id="scene"' not in apart
