"""The training settings that a user can change: one frozen object read by the command line, the cache key and the trainer."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from ..pipeline import Settings

Strategy = Literal["two-stage", "joint", "alternating", "progressive"]


class RefinementSettings(Settings):
    """Settings that apply wherever a model is trained. Learning rates of positions are fractions of the viewing distance."""

    renamed: ClassVar = {"still": "rest"}

    iterations: int | None = Field(6000, ge=0, le=1_000_000, description="optimiser steps of this stage")
    seed: int = Field(
        0, ge=0, le=2**31 - 1, description="seed of the order of views, the initial planes and the sampling of new primitives"
    )
    sh_degree: int | None = Field(
        None, ge=0, le=3, description="highest degree of the colours' spherical harmonics; 1 for rigs and one narrow path, else 2"
    )
    lr_means: float = Field(8e-4, gt=0, description="initial learning rate of positions; decays to a fiftieth")
    lr_field: float = Field(2e-2, gt=0, description="initial learning rate of the planes; decays to a tenth")
    lr_mlp: float = Field(3e-3, gt=0, description="initial learning rate of the deformation MLP; decays to a tenth")
    lr_nodes: float = Field(3e-3, gt=0, description="initial learning rate of the control nodes' network; decays to a fiftieth")
    l1: float = Field(0.8, ge=0, description="lambda_1 of Eq. 9, weight of L1")
    ssim: float = Field(0.2, ge=0, description="lambda_2 of Eq. 9, weight of 1 - SSIM")
    tv: float = Field(1e-2, ge=0, description="lambda_3 of Eq. 9, weight of the smoothness of the planes")
    alpha: float = Field(
        0.2, ge=0, description="weight of the difference from the capture's alpha, if it has any; 0 also compares on one background alone"
    )
    rest: float | None = Field(
        None, ge=0, description="weight of the mean distance from rest, in viewing distances; 0.005 for planes, else 0"
    )
    rigid: float = Field(
        0.01, ge=0, description="weight of how differently neighbours move, so that parts move rigidly; 0 in the first motion of nodes"
    )
    inertia: float | None = Field(None, ge=0, description="weight of how abruptly motion changes between times; 0.03 for nodes, else 0.01")
    opacity: float | None = Field(
        None, ge=0, description="px of error that an opaque primitive must remove, or it fades; 0.15 for planes, else 0.01"
    )
    spread: float | None = Field(None, ge=0, description="weight of the spread in depth of what one pixel shows; 0.3 for nodes, else 0")
    smooth: float = Field(2.0, ge=0, description="rigs: weight of how much surfaces bend where pictures are smooth; falls to a twentieth")
    dropout: float = Field(
        0.2, ge=0, lt=1, description="rigs: share of the Gaussians at rest that a step leaves out at random; grows from 0"
    )
    depth: float = Field(
        0.3, ge=0, description="weight of the difference from the depth measured between cameras, or along one's path, where known"
    )
    moving_depth: float = Field(
        0.3, ge=0, description="before one camera: weight of how far what moves is from the depth of its seeds, or from the capture's depth"
    )
    interval: float | None = Field(None, ge=0, description="weight of L_interval (Eq. 8), with flow in px; 0.001 for planes, else 0")
    data_flow: float = Field(1e-3, ge=0, description="weight of the difference of rendered and measured flow at edges, px; 0 turns it off")
    flow_every: int = Field(8, ge=1, description="steps between two evaluations of the flow terms")
    densify_every: int = Field(0, ge=0, description="steps between two rounds of density control; 0: 100, or for nodes at most 150 rounds")
    densify_until: float | None = Field(
        None, ge=0, le=1, description="fraction of the steps at which density control ends; 0.75 for planes, 0.8 for nodes"
    )
    min_opacity: float = Field(0.01, ge=0, lt=1, description="primitives with a lower opacity are pruned")
    min_weight: float = Field(
        0.25, ge=0, description="px per view; primitives that contribute less, on average, are removed late in training"
    )
    affine: bool = Field(True, description="affine colour correction: one per camera, for several cameras; one per photo of a static scene")
    patience: int = Field(1000, ge=100, description="stop when the loss has not improved over this many steps")
    checkpoint_seconds: float = Field(20.0, gt=0, description="seconds between two checkpoints")


class GrowthSettings(Settings):
    """Settings that apply only where primitives are added: in `coarse`, and in `fine` with the joint strategy, which then acts like
    `coarse`."""

    budget: int = Field(0, ge=0, description="most Gaussians; 0: chosen for the capture")
    open_until: float = Field(0.7, ge=0, le=1, description="rigs: fraction of the steps until all times are in use; 0: from the start")
    hidden: float = Field(
        0.3, ge=0, lt=1, description="share of a Gaussian that some training view must see, or it is removed; 0: none are"
    )


class TrainingSettings(GrowthSettings, RefinementSettings):
    """Both groups together: what the trainer reads."""
