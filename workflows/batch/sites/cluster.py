"""Runs the scenes of a batch through Parsl: on this machine, Slurm or Kubernetes. CPU parts and training use separate pools."""

from __future__ import annotations

import math
import os
import shlex
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from ....pipeline import SettingsError
from ...machine import orphan
from ..ledger import Ledger, SceneState
from ..listing import Entry
from ..work import PARTS, StageFailed
from ..yaml_files import read_yaml
from .pools import Cluster, Pool

INTERCHANGE = "parsl.executors.high_throughput.interchange"  # between this process and the workers
PROGRAMS = Path(sys.executable).parent  # Parsl's programs are beside the interpreter, even if its environment is not activated
LOSSES = 20  # lost workers that count as one failed try, so that a node that always dies ends after a while
LOOKS = 4  # checks of a worker, and of the queue, within `Cluster.lost_after`


def read_cluster(file: Path) -> Cluster:
    """Reads a cluster's file. Raises SettingsError that names the file and the field."""
    try:
        return Cluster.model_validate(read_yaml(file) or {})
    except ValidationError as error:
        first = error.errors()[0]
        field = ".".join(map(str, first["loc"]))
        raise SettingsError(f"--executor {file}: {field}: {first['msg']}") from error
    except (OSError, ValueError) as error:
        raise SettingsError(
            f"--executor {file}: cannot be read as YAML ({error}); files to begin with are in workflows/clusters"
        ) from error


class Parsl:
    """Like `local.Local`, but on the pools of ``cluster``. Raises SettingsError if Parsl is not installed."""

    def __init__(self, ledger: Ledger, cluster: Cluster, timeout: float | None) -> None:
        try:
            import parsl
            from parsl.config import Config
            from parsl.jobs.error_handlers import windowed_error_handler
        except ImportError as error:
            raise SettingsError("--executor FILE.yaml needs the package parsl; install it with: pip install 'e4dgs[cluster]'") from error
        self.ledger, self.cluster, self.timeout = ledger, cluster, timeout
        pools = {"cpu": cluster.cpu} | ({"gpu": cluster.gpu} if cluster.gpu is not None else {})
        # Parsl's default handler gives up a pool once all of its jobs so far have failed; with one node, a single loss would do that.
        executors = [_executor(name, pool, cluster.lost_after, windowed_error_handler) for name, pool in pools.items()]
        config = Config(
            executors=executors,
            retries=LOSSES * (cluster.retries + 1) - 1,
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
                pool = self.cluster.pool(part)
                threads = pool.cores or (None if pool.provider == "local" else 1)
                args = str(self.ledger.workspace), self.ledger.name, entry.name, part, self.timeout, threads, pool.memory_gb
                done = self._apps["gpu" if pool is self.cluster.gpu else "cpu"](done, *args)
                done.add_done_callback(lambda future, scene=entry.name: self._lost(scene, future))
            ends.append(done)
        return ends

    def stop(self) -> None:
        """Ends the workers and what runs on them; checkpoints stay."""
        self._kernel.cleanup()

    def _lost(self, scene: str, future: Future[bool]) -> None:
        """Records why a part could not run at all. A failure of a stage itself is already in the scene's state."""
        error = future.exception()
        progress = self.ledger.progress(scene)
        if error is None or isinstance(error, StageFailed) or type(error).__name__ == "DependencyError" or progress.state == "failed":
            return
        said = " | ".join(line.strip() for line in str(error).splitlines() if line.strip())
        message = f"no worker of the cluster could run it: {type(error).__name__}: {said}"
        self.ledger.write(scene, SceneState("failed", progress.stage, message, progress.seconds, progress.attempts))


def _part_after(before: bool, *args: Any) -> bool:
    """Runs on a worker. ``before`` is what the previous part returned."""
    from e4dgs.workflows.batch.work import run_part

    return bool(before) and run_part(*args)


def _cost(error: Exception, task: Any) -> float:
    """How many losses a failure counts as. A part is not retried if the previous part failed or its pool was given up."""
    if type(error).__name__ in ("DependencyError", "BadStateException"):
        return float("inf")
    return LOSSES if isinstance(error, StageFailed) else 1


def _executor(name: str, pool: Pool, lost_after: int, give_up: Callable[..., None]) -> Any:
    from parsl.executors import HighThroughputExecutor

    more: dict[str, Any] = {} if pool.address is None else {"address": pool.address}
    if pool.provider == "local" and pool.address is None:
        more["address"] = "127.0.0.1"
    if pool.gpus and not (pool.provider == "slurm" and pool.workers == 1):  # a job's only worker keeps the GPU that Slurm assigned
        more["available_accelerators"] = pool.gpus
    if pool.memory_gb is not None:
        more["mem_per_worker"] = pool.memory_gb
    return HighThroughputExecutor(
        label=name,
        max_workers_per_node=pool.workers,
        provider=_provider(pool, lost_after),
        cores_per_worker=pool.cores or 1,
        interchange_launch_cmd=[sys.executable, "-P", "-m", orphan.__name__, str(os.getpid()), INTERCHANGE],  # or it would outlive us
        block_error_handler=give_up,
        heartbeat_period=max(1, lost_after // LOOKS),
        heartbeat_threshold=lost_after,
        encrypted=False,
        **more,
    )


def _provider(pool: Pool, lost_after: int) -> Any:
    blocks: dict[str, Any] = {"init_blocks": 1, "min_blocks": 0, "max_blocks": pool.nodes}
    setup = f"export PATH={shlex.quote(str(PROGRAMS))}:$PATH\n{pool.setup}"  # has Parsl's worker, unless setup provides another
    if pool.provider == "local":
        from parsl.providers import LocalProvider

        return LocalProvider(worker_init=setup, **blocks)
    if pool.provider == "slurm":
        from parsl.providers import SlurmProvider

        class Slurm(SlurmProvider):  # type: ignore[misc]
            """Polls its jobs often enough to notice every one that ended."""

            @property
            def status_polling_interval(self) -> int:
                return min(60, max(1, lost_after // LOOKS))

        return Slurm(
            partition=pool.partition,
            account=pool.account,
            walltime=pool.walltime,
            scheduler_options=pool.options,
            worker_init=setup,
            nodes_per_block=1,
            cores_per_node=pool.workers * (pool.cores or 1),
            mem_per_node=math.ceil(pool.workers * pool.memory_gb) if pool.memory_gb else None,  # 0 would mean all of a node's memory
            exclusive=False,
            **blocks,
        )
    from .pods import pods

    return pods(pool, min(60, max(1, lost_after // LOOKS)))
