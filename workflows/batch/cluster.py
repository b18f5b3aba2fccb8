"""Scenes of a batch on what Parsl reaches: this machine, Slurm, Kubernetes. CPU parts and training go to pools of their own."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from ...pipeline import SettingsError, StageError
from .ledger import Ledger
from .listing import Entry
from .work import PARTS, StageFailed

PROGRAMS = Path(sys.executable).parent  # Parsl's own lie beside the interpreter, whether its environment is activated or not
LOST = 0.05  # of a try: what a lost worker counts, so that a node that always dies ends after a while


class Pool(BaseModel):
    """Workers of one kind."""

    model_config = ConfigDict(extra="forbid")
    provider: Literal["local", "slurm", "kubernetes"] = "local"
    workers: int = Field(1, ge=1, description="scenes at a time on one node")
    cores: int | None = Field(None, ge=1, description="threads of each worker")
    memory_gb: float | None = Field(None, gt=0, description="of each worker")
    gpus: int = Field(0, ge=0, description="of one node")
    nodes: int = Field(1, ge=1, description="most nodes, or pods, at a time")
    walltime: str = "04:00:00"
    partition: str | None = None
    account: str | None = None
    options: str = Field("", description="further #SBATCH lines")
    setup: str = Field("", description="shell lines before a worker starts, such as the activation of an environment")
    image: str | None = Field(None, description="kubernetes: container image with e4dgs")
    namespace: str = "default"
    volumes: list[tuple[str, str]] = Field(default_factory=list, description="kubernetes: claim and where it is mounted")
    address: str | None = Field(None, description="of the head, as nodes reach it")


class Cluster(BaseModel):
    """A file of `workflows/clusters`. gpu: for training; None: the CPU's pool trains."""

    model_config = ConfigDict(extra="forbid")
    retries: int = Field(1, ge=0, description="further tries of a stage that failed; lost workers hardly count")
    cpu: Pool = Pool.model_validate({})
    gpu: Pool | None = None


def read_cluster(file: Path) -> Cluster:
    """Raises SettingsError that names the file and the field."""
    import yaml

    try:
        return Cluster.model_validate(yaml.safe_load(file.read_text(encoding="utf-8")) or {})
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise SettingsError(
            f"--executor {file}: cannot be read as YAML ({error}); files to begin with are in workflows/clusters"
        ) from error
    except ValidationError as error:
        first = error.errors()[0]
        field = ".".join(map(str, first["loc"]))
        raise SettingsError(f"--executor {file}: {field}: {first['msg']}") from error


class Parsl:
    """As `local.Local`, on the pools of ``cluster``. Raises StageError where Parsl is not installed."""

    def __init__(self, ledger: Ledger, cluster: Cluster, timeout: float | None) -> None:
        try:
            import parsl
            from parsl.config import Config
        except ImportError as error:
            raise StageError("--executor FILE.yaml needs the package parsl; install it with: pip install 'e4dgs[cluster]'") from error
        self.ledger, self.cluster, self.timeout = ledger, cluster, timeout
        pools = {"cpu": cluster.cpu} | ({"gpu": cluster.gpu} if cluster.gpu is not None else {})
        config = Config(
            executors=[_executor(name, pool) for name, pool in pools.items()],
            retries=cluster.retries,
            retry_handler=_cost,
            run_dir=str(ledger.folder / "parsl"),
            initialize_logging=False,
            usage_tracking=0,
        )
        self._kernel = parsl.DataFlowKernel(config)
        self._apps = {name: parsl.python_app(_part_after, data_flow_kernel=self._kernel, executors=[name]) for name in pools}

    def start(self, entries: Sequence[Entry]) -> list[Future[bool]]:
        ends = []
        for entry in entries:
            done: Any = True
            for part in PARTS:
                name = "gpu" if part == "train" and self.cluster.gpu is not None else "cpu"
                pool = self.cluster.gpu if name == "gpu" else self.cluster.cpu
                assert pool is not None
                args = str(self.ledger.workspace), self.ledger.name, entry.name, part, self.timeout, pool.cores
                done = self._apps[name](done, *args)
            ends.append(done)
        return ends

    def stop(self) -> None:
        """Workers end, and what runs on them; checkpoints stay."""
        self._kernel.cleanup()


def _part_after(before: bool, *args: Any) -> bool:
    """Runs on a worker; ``before`` is what the part before has returned."""
    from e4dgs.workflows.batch.work import run_part

    return bool(before) and run_part(*args)


def _cost(error: Exception, task: Any) -> float:
    """How much of a try a failure counts. A part whose part before has failed is not tried at all."""
    if type(error).__name__ == "DependencyError":
        return float("inf")
    return 1.0 if isinstance(error, StageFailed) else LOST


def _executor(name: str, pool: Pool) -> Any:
    from parsl.executors import HighThroughputExecutor

    more: dict[str, Any] = {} if pool.address is None else {"address": pool.address}
    if pool.provider == "local" and pool.address is None:
        more["address"] = "127.0.0.1"
    if pool.gpus:
        more["available_accelerators"] = pool.gpus
    if pool.memory_gb is not None:
        more["mem_per_worker"] = pool.memory_gb
    return HighThroughputExecutor(
        label=name,
        max_workers_per_node=pool.workers,
        provider=_provider(pool),
        cores_per_worker=pool.cores or 1,
        interchange_launch_cmd=[str(PROGRAMS / "interchange.py")],
        encrypted=False,
        **more,
    )


def _provider(pool: Pool) -> Any:
    blocks: dict[str, Any] = {"init_blocks": 1, "min_blocks": 0, "max_blocks": pool.nodes}
    if pool.provider == "local":
        from parsl.providers import LocalProvider

        return LocalProvider(worker_init=f"export PATH={shlex.quote(str(PROGRAMS))}:$PATH\n{pool.setup}", **blocks)
    if pool.provider == "slurm":
        from parsl.providers import SlurmProvider

        return SlurmProvider(
            partition=pool.partition,
            account=pool.account,
            walltime=pool.walltime,
            scheduler_options=pool.options,
            worker_init=pool.setup,
            nodes_per_block=1,
            cores_per_node=pool.workers * pool.cores if pool.cores else None,
            mem_per_node=round(pool.workers * pool.memory_gb) if pool.memory_gb else None,
            exclusive=False,
            **blocks,
        )
    from parsl.providers import KubernetesProvider

    if pool.image is None:
        raise SettingsError("kubernetes: image: name a container image that holds e4dgs")
    return KubernetesProvider(
        image=pool.image,
        namespace=pool.namespace,
        worker_init=pool.setup,
        nodes_per_block=1,
        max_cpu=float(pool.workers * (pool.cores or 1)),
        max_mem=f"{round(pool.workers * (pool.memory_gb or 4))}Gi",
        persistent_volumes=list(pool.volumes),
        **blocks,
    )
