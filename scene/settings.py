"""The training settings that a user can change: one frozen object read by the command line, the cache key and the trainer."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from ..pipeline import Settings

Strategy = Literal["two-stage", "joint", "alternating", "progressive"]


class RefinementSettings(Settings):
    """Settings that apply wherever a model is trained. Learning rates of positions are fractions of the viewing distance."""

    renamed: ClassVar = {"still": "rest"}

    iterations: int = Field(6000, ge=0, le=1_000_000, description="optimiser steps of this stage")
    seed: int = Field(0, ge=0, description="order of the views, initial planes, sampling of new primitives")
    sh_degree: int | None = Field(None, ge=0, le=3, description="highest spherical harmonic of the colours; 2, for rigs 1")
    lr_means: float = Field(8e-4, gt=0, description="first learning rate of positions, decays to a fiftieth")
    lr_field: float = Field(2e-2, gt=0, description="first learning rate of the planes, decays to a tenth")
    lr_mlp: float = Field(3e-3, gt=0, description="first learning rate of the deformation MLP, decays to a tenth")
    lr_nodes: float = Field(3e-3, gt=0, description="first learning rate of the control nodes' network, decays to a fiftieth")
    l1: float = Field(0.8, ge=0, description="lambda_1 of Eq. 9")
    ssim: float = Field(0.2, ge=0, description="lambda_2 of Eq. 9")
    tv: float = Field(1e-2, ge=0, description="lambda_3 of Eq. 9, smoothness of the planes")
    alpha: float = Field(0.2, ge=0, description="weight of the difference from the capture's own alpha, where it has one")
    rest: float | None = Field(None, ge=0, description="weight of the mean displacement, in viewing distances; 0.005 for planes, else 0")
    rigid: float = Field(0.01, ge=0, description="weight of how differently neighbours move: parts turn and shift as one")
    inertia: float | None = Field(None, ge=0, description="weight of how abruptly motion changes between times; 0.03 for nodes, else 0.01")
    opacity: float | None = Field(
        None, ge=0, description="px of error that an opaque primitive must save, else it fades; 0.15 for planes, 0.01 for nodes"
    )
    spread: float | None = Field(
        None, ge=0, description="weight of how far apart in depth lies what one pixel shows; 0.3 for nodes, else 0"
    )
    smooth: float = Field(2.0, ge=0, description="rigs: weight of how much surfaces bend where pictures are smooth")
    depth: float = Field(0.3, ge=0, description="rigs: weight of the difference from depth measured between cameras, where there is any")
    interval: float = Field(1e-3, ge=0, description="weight of L_interval (Eq. 8), flow in px; 0 turns it off")
    data_flow: float = Field(1e-3, ge=0, description="weight of rendered against measured flow at edges, px; 0 turns it off")
    flow_every: int = Field(8, ge=1, description="the two flow terms are evaluated at every n-th step")
    densify_every: int = Field(0, ge=0, description="steps between two rounds of density control; 0: 100, with nodes at most 150 rounds")
    densify_until: float | None = Field(
        None, ge=0, le=1, description="last round of density control, as a fraction of the steps; 0.75 for planes, 0.8 for nodes"
    )
    min_opacity: float = Field(0.01, ge=0, lt=1, description="primitives below are pruned")
    min_weight: float = Field(0.25, ge=0, description="px a view; primitives that blend into less, on average, are removed late")
    affine: bool = Field(True, description="one colour affine a camera, for captures of several cameras, or a photo of a static scene")
    patience: int = Field(1000, ge=100, description="stop when the loss has not improved over this many steps")
    checkpoint_seconds: float = Field(20.0, gt=0, description="time between two checkpoints")


class GrowthSettings(Settings):
    """Settings that apply only where primitives are added: in `coarse`, and in `fine` with the joint strategy, which then acts like
    `coarse`."""

    budget: int = Field(0, ge=0, description="most Gaussians allowed; 0 chooses by the capture")
    open_until: float = Field(0.7, ge=0, le=1, description="rigs: fraction of the steps until all times are in; 0: at once")
    hidden: float = Field(0.3, ge=0, lt=1, description="Gaussians of which no training view sees this share are removed; 0: none are")


class TrainingSettings(GrowthSettings, RefinementSettings):
    """Both groups together: what the trainer reads."""
