"""What the plan promises, against what was measured (benchmarks/results/quality.json, two cores)."""

import json
from pathlib import Path

import pytest
from e4dgs.stages.coarse import Coarse, CoarseSettings
from e4dgs.stages.fine import Fine, FineSettings

RESULTS = Path(__file__).parents[2] / "benchmarks" / "results" / "quality.json"
RIG = {"static": False, "pairs": 300}
FACTS = {
    "stage": RIG | {"width": 480, "height": 270, "frames": 360, "cameras": 8, "times": 45},
    "basketball": RIG | {"width": 640, "height": 360, "frames": 372, "cameras": 31, "times": 12},
    "robot": {"width": 400, "height": 400, "frames": 130, "cameras": 130, "times": 110, "pairs": 0, "static": False},
    "lego": {"width": 400, "height": 400, "frames": 81, "cameras": 81, "times": 67, "pairs": 0, "static": False},
}


@pytest.mark.parametrize("scene", FACTS)
def test_training_takes_what_the_plan_says_within_two_thirds(scene):
    measured = json.loads(RESULTS.read_text())["results"][scene]["metrics"]["train_seconds"]
    promised = Coarse().estimate(FACTS[scene], CoarseSettings()) + Fine().estimate(FACTS[scene], FineSettings())
    assert 0.6 < promised / measured < 1.67
