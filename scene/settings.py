"""The training settings that a user can change: one frozen object read by the command line, the cache key and the trainer."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from ..pipeline import Settings

# Weights of the loss, without the ending of their names in the settings.
_WEIGHTS = ("l1", "ssim", "tv", "alpha", "rest", "rigid", "inertia", "opacity", "spread", "smooth", "depth", "interval", "data_flow")
Strategy = Literal["two-stage", "joint", "alternating", "progressive"]


class RandomSettings(Settings):
    """The seed of everything that `seeds`, `coarse` and `fine` draw at random."""

    group: ClassVar = "train"

    seed: int = Field(
        0,
        ge=0,
        le=2**31 - 1,
        description="seed of the choice of first Gaussians, the order of views, the initial planes and the sampling of new primitives",
    )


class BudgetSettings(Settings):
    """How many Gaussians there may be: `seeds` leaves room for more, and growth stops there."""

    group: ClassVar = "train"

    respelled: ClassVar = {"budget": {"0": None}}

    budget: int | None = Field(
        None, ge=1, description="most Gaussians, convexes included; none: chosen for the capture, and counted at one time"
    )


class MotionSettings(Settings):
    """What moves primitives: `seeds` places what the motion starts from."""

    group: ClassVar = "train"

    respelled: ClassVar = {"motion": {"auto": None, "free": "lifetimes"}}

    motion: Literal["planes", "nodes", "lifetimes"] | None = Field(
        None,
        description="what moves primitives: planes, the six-plane field; nodes, control nodes; lifetimes, each primitive moves and lives "
        "for a time of its own. none: nodes if each frame is seen from another side, lifetimes if masks show what moves, else planes",
    )


class RefinementSettings(RandomSettings):
    """Settings that apply wherever a model is trained. Learning rates of positions are fractions of the viewing distance."""

    group: ClassVar = "train"
    renamed: ClassVar = {name: f"train.{name}_weight" for name in _WEIGHTS} | {
        "still": "train.rest_weight",
        "min_weight": "train.min_contribution",
        "lr_mlp": "train.lr_network",
        "lr_nodes": "train.lr_network",
    }

    iterations: int | None = Field(6000, ge=0, le=1_000_000, description="optimiser steps of this stage")
    sh_degree: int | None = Field(
        None, ge=0, le=3, description="highest degree of the colours' spherical harmonics; 1 for rigs and one narrow path, else 2"
    )
    lr_means: float = Field(8e-4, gt=0, description="initial learning rate of positions; decays to a fiftieth")
    lr_field: float = Field(2e-2, gt=0, description="initial learning rate of the planes; decays to a tenth")
    lr_network: float = Field(
        3e-3, gt=0, description="initial learning rate of the motion's network; decays to a tenth (planes) or a fiftieth"
    )
    l1_weight: float = Field(0.8, ge=0, description="lambda_1 of Eq. 9, weight of L1")
    ssim_weight: float = Field(0.2, ge=0, description="lambda_2 of Eq. 9, weight of 1 - SSIM")
    tv_weight: float = Field(1e-2, ge=0, description="lambda_3 of Eq. 9, weight of the smoothness of the planes")
    alpha_weight: float = Field(
        0.2, ge=0, description="weight of the difference from the capture's alpha, if it has any; 0 also compares on one background alone"
    )
    rest_weight: float | None = Field(
        None, ge=0, description="weight of the mean distance from rest, in viewing distances; 0.005 for planes, else 0"
    )
    rigid_weight: float = Field(
        0.01, ge=0, description="weight of how differently neighbours move, so that parts move rigidly; 0 in the first motion of nodes"
    )
    inertia_weight: float | None = Field(
        None, ge=0, description="weight of how abruptly motion changes between times; 0.03 for nodes, else 0.01"
    )
    opacity_weight: float | None = Field(
        None, ge=0, description="px of error that an opaque primitive must remove, or it fades; 0.15 for planes, else 0.01"
    )
    spread_weight: float | None = Field(
        None, ge=0, description="weight of the spread in depth of what one pixel shows; 0.3 for nodes, else 0"
    )
    smooth_weight: float = Field(
        2.0, ge=0, description="rigs: weight of how much surfaces bend where pictures are smooth; falls to a twentieth"
    )
    dropout: float = Field(
        0.2, ge=0, lt=1, description="rigs: share of the Gaussians at rest that a step leaves out at random; grows from 0"
    )
    depth_weight: float = Field(
        0.3,
        ge=0,
        description="weight of the difference from depth that was measured between cameras or along a path, or came with the capture",
    )
    interval_weight: float | None = Field(None, ge=0, description="weight of L_interval (Eq. 8), with flow in px; 0.001 for planes, else 0")
    data_flow_weight: float = Field(
        1e-3, ge=0, description="weight of the difference of rendered and measured flow at edges, px; 0 turns it off"
    )
    flow_every: int = Field(8, ge=1, description="steps between two evaluations of the flow terms")
    densify_every: int | None = Field(
        None, ge=1, description="steps between two rounds of density control; none: 100, or for nodes at most 150 rounds"
    )
    densify_until: float | None = Field(
        None, ge=0, le=1, description="fraction of the steps at which density control ends; 0.75 for planes, 0.8 for nodes"
    )
    min_opacity: float = Field(0.01, ge=0, lt=1, description="primitives with a lower opacity are pruned")
    min_contribution: float = Field(
        0.25, ge=0, description="px per view; primitives that contribute less, on average, are removed late in training"
    )
    affine: bool = Field(True, description="affine colour correction: one per camera, for several cameras; one per photo of a static scene")
    patience: int = Field(1000, ge=100, description="stop when the loss has not improved over this many steps")
    checkpoint_seconds: float = Field(20.0, gt=0, description="seconds between two checkpoints")


class GrowthSettings(BudgetSettings):
    """Settings that apply only where primitives are added: in `coarse`, and in `fine` with the joint strategy, which then acts like
    `coarse`."""

    open_until: float = Field(0.7, ge=0, le=1, description="rigs: fraction of the steps until all times are in use; 0: from the start")
    hidden: float = Field(
        0.3, ge=0, lt=1, description="share of a Gaussian that some training view must see, or it is removed; 0: none are"
    )


class TrainingSettings(GrowthSettings, RefinementSettings):
    """Both groups together: what the trainer reads."""
