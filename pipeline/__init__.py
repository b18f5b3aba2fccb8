"""The stages, keys, store, plan and runner of a workflow. Nothing here knows about 3D. See DESIGN.md."""

from .earlier import Earlier
from .errors import ArtifactError, CaptureError, DamagedError, PipelineError, SettingsError, StageError
from .graph import Graph, check_targets
from .job import Job
from .machine.resources import Resources
from .machine.threads import thread_count
from .plan import Row, make_plan
from .records import Records
from .running.build import Outcome
from .running.progress import Progress, counted, duration
from .running.runner import Runner
from .running.say import say
from .settings import Settings, build_settings, describe, settings_by_name, split_assignment
from .stage import Applies, Capture, Context, Given, Stage
from .storage.artifact import Artifact
from .storage.collect import Collected, collect, unused
from .storage.pins import Pins
from .storage.store import Store
from .storage.writer import ArtifactWriter
from .why import explain

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
    "Earlier",
    "Given",
    "Graph",
    "Job",
    "Outcome",
    "Pins",
    "PipelineError",
    "Progress",
    "Records",
    "Resources",
    "Row",
    "Runner",
    "Settings",
    "SettingsError",
    "Stage",
    "StageError",
    "Store",
    "build_settings",
    "check_targets",
    "collect",
    "counted",
    "describe",
    "duration",
    "explain",
    "make_plan",
    "say",
    "settings_by_name",
    "split_assignment",
    "thread_count",
    "unused",
]
