"""The pools of workers that a batch runs on, as a YAML file describes them."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from ..work import PARTS


class Pool(BaseModel):
    """Workers of one kind."""

    model_config = ConfigDict(extra="forbid")
    provider: Literal["local", "slurm", "kubernetes"] = "local"
    workers: int = Field(1, ge=1, description="scenes that run on one node at the same time")
    cores: int | None = Field(None, ge=1, description="threads of each worker; by default 1, for local all cores")
    memory_gb: float | None = Field(None, gt=0, description="memory of each worker; a stage that takes more is stopped")
    gpus: int = Field(0, ge=0, description="GPUs of one node or pod; for Slurm, request them in options as well")
    nodes: int = Field(1, ge=1, description="most nodes or pods at the same time")
    walltime: str = "04:00:00"
    partition: str | None = None
    account: str | None = None
    options: str = Field("", description="further #SBATCH lines")
    setup: str = Field("", description="shell lines that run before a worker, for example to activate an environment")
    image: str | None = Field(None, description="kubernetes: container image with e4dgs")
    namespace: str = "default"
    volumes: list[tuple[str, str]] = Field(default_factory=list, description="kubernetes: each claim and where it is mounted")
    address: str | None = Field(None, description="address at which nodes reach the head")


class Cluster(BaseModel):
    """A file like those in `workflows/clusters`. gpu: pool for training and what follows; None: the CPU pool does everything."""

    model_config = ConfigDict(extra="forbid")
    retries: int = Field(1, ge=0, description="how often a failed stage is retried; lost workers hardly count")
    lost_after: int = Field(120, ge=4, description="seconds without a sign of life from a node after which its scenes go to another")
    cpu: Pool = Pool.model_validate({})
    gpu: Pool | None = None

    def pool(self, part: str) -> Pool:
        """The pool in which ``part`` of `PARTS` runs."""
        return self.cpu if part == PARTS[0] or self.gpu is None else self.gpu
