"""The stages of a workflow, in the order in which they run."""

from collections.abc import Iterable, Iterator, Sequence

from .errors import SettingsError
from .settings import Settings
from .stage import Stage


class Graph:
    """A directed acyclic graph of stages. Raises ValueError unless every stage is listed once and after its inputs."""

    def __init__(self, stages: Sequence[Stage]) -> None:
        self.stages: dict[str, Stage] = {}
        for stage in stages:
            missing = [name for name in stage.inputs if name not in self.stages]
            if stage.name in self.stages or missing:
                problem = f"reads {', '.join(missing)}, which must be listed before it" if missing else "is listed twice"
                raise ValueError(f"stage {stage.name} {problem}")
            self.stages[stage.name] = stage

    def __iter__(self) -> Iterator[Stage]:
        return iter(self.stages.values())

    def __getitem__(self, name: str) -> Stage:
        if name not in self.stages:
            raise SettingsError(f"there is no stage {name!r}; stages: {', '.join(self.stages)}")
        return self.stages[name]

    @property
    def settings(self) -> dict[str, type[Settings]]:
        """The settings class of every stage, by stage name."""
        return {stage.name: stage.settings for stage in self}

    def needed_for(self, targets: Iterable[str]) -> list[Stage]:
        """The targets and every stage that they read directly or indirectly, in running order."""
        wanted: set[str] = set()
        pending = list(targets)
        while pending:
            name = pending.pop()
            if name not in wanted:
                wanted.add(name)
                pending.extend(self[name].inputs)
        return [stage for stage in self if stage.name in wanted]


def check_targets(graph_names: Iterable[str], target: str) -> list[str] | None:
    """``"all"`` -> None (every stage); a stage's name -> a list of just that name. Raises SettingsError for anything else."""
    names = list(graph_names)
    if target == "all":
        return None
    if target not in names:
        raise SettingsError(f"there is no stage {target!r}; give one of: all, {', '.join(names)}")
    return [target]
