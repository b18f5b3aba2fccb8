"""Depth of single pictures by a published network, which transformers loads and runs."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from ...pipeline import StageError
from .align import INVERSE, SCALE

METRIC_TYPES = ("depth_pro", "glpn", "zoedepth")  # architectures whose networks give depth, whatever their config says
UNKNOWN = 1e-6  # added to inverse depth: 0 is what is farthest there, and what is unknown in a map
_WEIGHTS = "model.safetensors", "model.safetensors.index.json"


class DepthNetwork:
    """A monocular depth network. kind: what its output is, one of the kinds of `align`."""

    def __init__(self, model: Path | str, device: str) -> None:
        """model: a folder as `save_pretrained` writes it, or NAME[@REVISION] on huggingface.co, which is downloaded once. Only safetensors
        are loaded, and never code. Raises StageError if it cannot be loaded."""
        transformers = _transformers()
        said = f"depth.model={model}"
        where, revision = str(model), None
        if isinstance(model, Path):
            _check(model, said)
        else:
            where, _, revision = where.partition("@")
        options: dict[str, Any] = {"revision": revision or "main", "trust_remote_code": False}
        try:
            self._prepare = transformers.AutoImageProcessor.from_pretrained(where, **options)
            network = transformers.AutoModelForDepthEstimation.from_pretrained(where, use_safetensors=True, **options)
        except Exception as error:  # of a network, of a file, of a config
            first = (str(error).strip() or type(error).__name__).splitlines()[0]
            advice = (
                "give the folder of a depth network of transformers, with config.json, preprocessor_config.json and model.safetensors"
                if isinstance(model, Path)
                else f"is there a network, and is that its name? Without one, copy the folder that `hf download {where}` fills, and give it"
            )
            raise StageError(f"{said}: it cannot be loaded ({first}); {advice}") from error
        self._network, self._device = network.eval().to(device), device
        metric = network.config.model_type in METRIC_TYPES or getattr(network.config, "depth_estimation_type", None) == "metric"
        self.kind = SCALE if metric else INVERSE

    def depth(self, picture: np.ndarray) -> np.ndarray:
        """Values [H, W] float32 of ``picture`` [H, W, 3] uint8: depth, or inverse depth up to scale and shift, by `kind`; 0 where there is
        none."""
        import torch

        inputs = self._prepare(images=picture, return_tensors="pt").to(self._device)
        with torch.inference_mode():
            found = self._network(**inputs)
        (one,) = self._prepare.post_process_depth_estimation(found, target_sizes=[picture.shape[:2]])
        values = np.maximum(one["predicted_depth"].float().cpu().numpy(), 0) + (UNKNOWN if self.kind == INVERSE else 0)
        return np.where(np.isfinite(values), values, 0).astype(np.float32)


def _transformers() -> Any:
    """The module, quiet. Raises StageError if it is not installed."""
    try:
        import transformers
    except Exception as error:  # not installed, or built for another torch
        raise StageError(f"depth.model needs transformers ({error}); install it with: pip install 'e4dgs[depth]'") from error
    transformers.utils.logging.set_verbosity_error()
    transformers.utils.logging.disable_progress_bar()
    return transformers


def _check(folder: Path, said: str) -> None:
    """Raises StageError if ``folder`` has no config or no safetensors."""
    names = os.listdir(folder)
    if "config.json" not in names:
        raise StageError(f"{said}: there is no config.json in it; give a folder as transformers' save_pretrained writes it")
    if not any(name in names for name in _WEIGHTS):
        pickled = next((name for name in names if name.endswith((".bin", ".pt", ".pth", ".ckpt"))), None)
        why = f"{pickled} is a pickle, which may run code, and is not read" if pickled else "there are no weights in it"
        raise StageError(f"{said}: {why}; it needs {_WEIGHTS[0]}")
