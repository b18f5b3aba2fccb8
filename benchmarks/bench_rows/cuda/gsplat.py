"""Our rasterizer beside gsplat's, on its own scene, in one run: time, what of it the GPU is busy, and memory."""

from __future__ import annotations

from importlib import metadata
from importlib.util import find_spec

import torch
from e4dgs.rasterizer import Frame
from e4dgs.rasterizer.reference.scene import Scene
from e4dgs.workflows.bench.cuda.gpu import CALLS, both_on_gpu, ending, gpu_name, need_gpu, on_gpu, peak_mib
from e4dgs.workflows.bench.render import Rasterize, forward
from e4dgs.workflows.bench.rows import Bench, Check, Measured
from e4dgs.workflows.bench.scenes import garden
from e4dgs.workflows.bench.timing import interleaved, ratio

from .gpu_times import gpu_times

FASTER = {"forward": 1.5, "both": 2.0}
PEERS = {"gsplat packed": True, "gsplat": False}  # packed is its default; ours is compared with the faster one
SIZES = ((648, 420), (1920, 1080))
TILED = (1, 4, 16)  # copies of the scene, each moved by the scene's own extent, as gsplat's benchmark does


def measure(bench: Bench) -> Measured:
    need_gpu()
    base, name = garden(bench)
    there = find_spec("gsplat") is not None
    checks, table, numbers = [], [], {}
    bench.expect(len(SIZES) * len(TILED))
    for width, height in SIZES:
        for copies in TILED:
            scene = on_gpu(resized(tiled(base, copies), *bench.size(width, height)))
            what = f"{copies}x at {scene.camera.width}x{scene.camera.height}"
            runs = {"ours forward": forward(scene), "ours both": both_on_gpu(scene)}
            for name_of, packed in PEERS.items() if there else ():
                rival_there = peer(scene, packed)
                runs |= {f"{name_of} forward": forward(scene, rival_there), f"{name_of} both": both_on_gpu(scene, rival_there)}
            times = interleaved(bench, {key: ending(run) for key, run in runs.items()})
            memory = {key: peak_mib(run) for key, run in runs.items()}
            busy = {key: 1e3 * sum(gpu_times(run).values()) for key, run in runs.items()}
            for part, bar in FASTER.items():
                checks.append(Check(f"{what}, {part}: ours", 1e3 * times[f"ours {part}"].median / CALLS, unit="ms"))
                if there:
                    fastest = min((times[f"{one} {part}"] for one in PEERS), key=lambda timing: timing.median)
                    value, note = ratio(fastest, times[f"ours {part}"])
                    checks.append(Check(f"{what}, {part}: gsplat's time over ours", value, bar, "above", note=note))
            if there:
                share = memory["ours both"] / min(memory[f"{one} both"] for one in PEERS)
                checks.append(Check(f"{what}: our memory over gsplat's, forward + backward", share, 1.0))
            table += [(what, key, f"{1e3 * times[key].median / CALLS:.3f}", f"{busy[key]:.3f}", f"{memory[key]:.0f}") for key in runs]
            numbers[what] = {"times": {k: t.json() for k, t in times.items()}, "gpu_ms": busy, "mib": memory}
            bench.tick(what)
    rival = (
        f"gsplat {metadata.version('gsplat')}" if there else "gsplat is not installed, so nothing is compared (pip install gsplat==1.5.3)"
    )
    return Measured(
        f"{name}; {rival}; {gpu_name()}; ten calls a run",
        checks,
        numbers,
        columns=("scene", "", "median ms a call", "ms of the GPU", "MiB"),
        table=table,
    )


def peer(scene: Scene, packed: bool) -> Rasterize:
    """gsplat's rasterizer as our benchmark calls ours: colours given, one camera, which is on the GPU already."""
    from gsplat import rasterization

    K, pose = scene.camera.K.cuda().float()[None], scene.camera.cam_from_world.cuda().float()[None]
    empty = torch.zeros(0)

    def render(camera, gaussians, convexes, background):
        parts = (gaussians.means, gaussians.quats, gaussians.scales, gaussians.opacities, gaussians.colors)
        color, alpha, _ = rasterization(*parts, pose, K, camera.width, camera.height, packed=packed)
        return Frame(color[0], alpha[0, ..., 0], empty, empty, empty, empty)

    return render


def tiled(scene: Scene, copies: int) -> Scene:
    """``copies`` of the Gaussians side by side on a square grid in x and y."""
    g = scene.gaussians
    assert g is not None
    if copies == 1:
        return scene
    side = round(copies**0.5)
    size = g.means.amax(0) - g.means.amin(0)
    shifts = [torch.tensor([i - side // 2, j - side // 2, 0.0]) * size for i in range(side) for j in range(side)]
    tensors = {f"gaussians.{name}": torch.cat([value] * copies) for name, value in vars(g).items() if value is not None}
    tensors["gaussians.means"] = torch.cat([g.means + shift for shift in shifts])
    return scene.having(tensors)


def resized(scene: Scene, width: int, height: int) -> Scene:
    """The same view in an image of this size."""
    K = scene.camera.K.clone()
    K[0] *= width / scene.camera.width
    K[1] *= height / scene.camera.height
    changed = scene.having({"K": K})
    changed.camera.width, changed.camera.height = width, height
    return changed
