"""Stages, keys, store, plan and runner of a workflow; knows nothing of 3D. See DESIGN.md."""

from .artifact import Artifact
from .collect import Collected, collect, unused
from .errors import ArtifactError, CaptureError, DamagedError, PipelineError, SettingsError, StageError
from .graph import Graph
from .job import Job
from .keys import capture_digest
from .pins import Pins
from .plan import Row, make_plan
from .progress import Progress, duration
from .records import Records
from .runner import Outcome, Runner, check_targets
from .settings import Settings, build_settings, describe, split_assignment
from .stage import Applies, Capture, Context, Stage
from .store import Store
from .why import explain
from .writer import ArtifactWriter

__all__ = [
    "Applies",
    "Artifact",
    "ArtifactError",
    "ArtifactWriter",
    "Capture",
    "CaptureError",
    "Collected",
    "Context",
    "DamagedError",
    "Graph",
    "Job",
    "Outcome",
    "Pins",
    "PipelineError",
    "Progress",
    "Records",
    "Row",
    "Runner",
    "Settings",
    "SettingsError",
    "Stage",
    "StageError",
    "Store",
    "build_settings",
    "capture_digest",
    "check_targets",
    "collect",
    "describe",
    "duration",
    "explain",
    "make_plan",
    "split_assignment",
    "unused",
]
