"""Gaussians over time as one USD file with a ParticleField3DGaussianSplat (UsdVol, OpenUSD 26.03 and later), for film and effects."""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ....pipeline.files import sync_file
from ....rasterizer import Gaussians
from ..axes import Turn, nearest_axis
from ..ply import drawable_rows, seen_rows
from .cameras import PosedCamera, define_cameras

REACH = 3.0  # standard deviations around each Gaussian that the bounding box includes
NOTE = (
    "Positions have the capture's own axes and unit of length (taken as a metre, which nobody measured); colours are display values (sRGB)."
)


def stage_turn(up: np.ndarray, wanted: str | None = None, exact: bool = False) -> Turn:
    """The turn of /World for a scene with the up direction ``up`` [3]. exact: the capture's axes have no meaning, so ``up`` itself counts
    and not the axis nearest to it.

    wanted: the stage's up axis, "Y" or "Z"; "capture" leaves the scene as it is; by default the axis nearest to ``up`` stays if it is one
    of the two, and becomes +Y otherwise. Raises ValueError for other axes, which USD does not know as up axes."""
    axis = nearest_axis(up)
    if wanted not in (None, "Y", "Z", "capture"):
        raise ValueError(f"{wanted} cannot be the up axis of a USD stage, which is Y or Z")
    if wanted == "capture":
        return Turn(axis, axis)
    after = wanted or (axis if axis in ("Y", "Z") else "Y")
    return Turn.levelling(up, after) if exact else Turn(axis, after)


def write_usd(
    path: Path,
    at: Callable[[float], Gaussians],
    times: Sequence[float],
    last_code: float,
    rate: float,
    turn: Turn,
    cameras: Sequence[PosedCamera] = (),
) -> int:
    """Write ``path`` (.usda as text; .usdc or .usd as binary crate), completely or not at all, and return the number of Gaussians. If that
    is 0, nothing is written.

    at: returns the Gaussians (with sh) at a time in [0, 1], always the same number in the same order. times: increasing; time t becomes
    time code t * last_code. rate: time codes a second. turn: that of /World, see `stage_turn`; its last axis is the stage's up axis (Y if
    that is neither Y nor Z). cameras: become /World/Cameras.

    /World/Splats has positions, orientations (unit), scales (standard deviations), opacities in [0, 1] and SH (0.5 is added, as in 3DGS).
    All are time samples of the same Gaussians, those visible at any of the times, so programs can interpolate between samples. Raises
    ImportError without usd-core, OSError if the file cannot be written.
    """
    from pxr import Gf, Usd, UsdVol, Vt

    stage = _empty_stage(times[0] * last_code, times[-1] * last_code, rate, turn)
    rows = [(seen_rows(moment), drawable_rows(moment)) for moment in map(at, times)]
    keep = torch.stack([seen for seen, _ in rows]).any(0) & torch.stack([drawable for _, drawable in rows]).all(0)
    if not keep.any():
        return 0
    splats = UsdVol.ParticleField3DGaussianSplat.Define(stage, "/World/Splats")
    # Without it, colours are taken as linear. There is no token for display values; this one has their primaries and curve.
    Usd.ColorSpaceAPI.Apply(splats.GetPrim()).CreateColorSpaceNameAttr(Gf.ColorSpaceNames.SRGBRec709)
    sh_degree = 0
    sample = _Samples()
    before: Tensor | None = None
    for t in times:
        moment, code = at(t), float(t * last_code)
        assert moment.sh is not None
        quats = torch.nn.functional.normalize(moment.quats[keep], dim=1)
        if before is not None:  # q and -q are the same rotation but interpolate differently
            quats = torch.where((quats * before).sum(1, keepdim=True) < 0, -quats, quats)
        before = quats
        means, scales, sh = as_float32(moment.means[keep]), as_float32(moment.scales[keep]), as_float32(moment.sh[keep])
        sh_degree = round(sh.shape[1] ** 0.5) - 1
        sample(splats.GetPositionsAttr(), code, means, Vt.Vec3fArray)
        sample(splats.GetOrientationsAttr(), code, as_float32(quats[:, [1, 2, 3, 0]]), Vt.QuatfArray)  # in memory the real part is last
        sample(splats.GetScalesAttr(), code, scales, Vt.Vec3fArray)
        sample(splats.GetOpacitiesAttr(), code, as_float32(moment.opacities[keep].clamp(0, 1)), Vt.FloatArray)
        sample(splats.GetRadianceSphericalHarmonicsCoefficientsAttr(), code, sh.reshape(-1, 3), Vt.Vec3fArray)
        reach = REACH * scales.max(1, keepdims=True)
        extent = np.stack([(means - reach).min(0), (means + reach).max(0)])
        sample(splats.GetExtentAttr(), code, extent, Vt.Vec3fArray)
    splats.GetRadianceSphericalHarmonicsDegreeAttr().Set(sh_degree)
    splats.GetProjectionModeHintAttr().Set("perspective")
    splats.GetSortingModeHintAttr().Set("zDepth")
    define_cameras(stage, "/World/Cameras", cameras, last_code)
    _export(stage.GetRootLayer(), path)
    return int(keep.sum())


def _empty_stage(first_code: float, last_code: float, rate: float, turn: Turn) -> Any:
    """A Usd.Stage in memory with its times, its up axis and a /World that is turned."""
    from pxr import Gf, Usd, UsdGeom

    stage = Usd.Stage.CreateInMemory()
    stage.GetRootLayer().documentation = NOTE
    stage.SetFramesPerSecond(rate)
    stage.SetTimeCodesPerSecond(rate)
    stage.SetStartTimeCode(first_code)
    stage.SetEndTimeCode(last_code)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    root = UsdGeom.Xform.Define(stage, "/World")
    stage.SetDefaultPrim(root.GetPrim())
    UsdGeom.SetStageUpAxis(stage, turn.after if turn.after in ("Y", "Z") else "Y")
    if turn.up is not None:
        root.AddOrientOp(UsdGeom.XformOp.PrecisionDouble).Set(Gf.Quatd(*map(float, turn.quat)))
    elif turn.degrees:
        about = nearest_axis(turn.about)
        add = {"X": root.AddRotateXOp, "Y": root.AddRotateYOp, "Z": root.AddRotateZOp}[about[-1]]
        add().Set(float(-turn.degrees if about[0] == "-" else turn.degrees))
    return stage


class _Samples:
    """Sets time samples of attributes. Consecutive equal samples share one array, so values that do not change are stored once."""

    def __init__(self) -> None:
        self._last: dict[str, tuple[np.ndarray, Any]] = {}

    def __call__(self, attribute: Any, code: float, array: np.ndarray, kind: Any) -> None:
        """kind: of the Vt arrays that the attribute takes."""
        before = known = self._last.get(attribute.GetName())
        if known is None or not np.array_equal(known[0], array):
            known = self._last[attribute.GetName()] = array, kind.FromNumpy(array)
        if before is None:  # readers that ask for no time take this value: without one they would find an empty scene
            attribute.Set(known[1])
        attribute.Set(known[1], code)


def as_float32(value: Tensor) -> np.ndarray:
    return np.ascontiguousarray(value.detach().cpu().numpy(), np.float32)


def _export(layer: Any, path: Path) -> None:
    from pxr import Tf

    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=f".{path.stem}-", dir=path.parent) as folder:
        part = Path(folder) / path.name
        try:
            kind = {"format": "usdc"} if path.suffix.lower() == ".usd" else {}  # else a variable of the environment decides
            done, told = layer.Export(str(part), args=kind), ""
        except Tf.ErrorException as error:  # a page of its insides: each write that failed, and what it then could not read back
            done, told = False, str(error)
        if not done:
            words = re.search(r"Error occurred writing file: ([^'\n]+)", told)
            raise OSError(None, words[1] if words else "the USD library failed", str(path))
        sync_file(part)
        os.replace(part, path)
