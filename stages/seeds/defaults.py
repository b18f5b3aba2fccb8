"""What `seeds` chooses for a capture: how many there are. Imports nothing heavy."""

from __future__ import annotations

from ..facts import Facts
from ..shared.defaults import one_way

SEEDS, MOST_SEEDS = 8000, 40_000


def auto_seeds(facts: Facts, budget: int) -> int:
    """Half the budget for rigs: growth adds primitives only near existing ones, so every wall needs some from the start. Also half along
    a path, between 8000 and 40,000. Else 8000."""
    if facts.rig:
        return budget // 2
    return min(max(budget // 2, SEEDS), MOST_SEEDS) if one_way(facts) else SEEDS
