"""Parsl workers in Kubernetes pods."""

from __future__ import annotations

import math
from typing import Any

from ....pipeline import SettingsError
from .pools import Pool

USUAL_MEMORY_GB = 4.0  # per worker; without a limit, a pod could use up its node's memory and be killed for it


def pods(pool: Pool, look: int) -> Any:
    """The Parsl provider that starts and ends the pods of ``pool``. look: seconds between two checks of them.

    Each pod requests as much as its limit, so that it gets a node with room for all of its workers. Raises SettingsError if the
    package kubernetes is not installed, the pool has no image, or no cluster is configured.
    """
    try:
        from kubernetes.client.exceptions import ApiException
        from kubernetes.config.config_exception import ConfigException
    except ImportError as error:
        raise SettingsError(
            "provider: kubernetes needs the package kubernetes; install it with: pip install 'e4dgs[kubernetes]'"
        ) from error
    from parsl.jobs.states import JobState, JobStatus
    from parsl.providers import KubernetesProvider

    class Pods(KubernetesProvider):  # type: ignore[misc]
        """Treats a pod that is gone (evicted, or its node was lost) as failed, for which Parsl would wait forever. Deleting it is then no
        error."""

        @property
        def status_polling_interval(self) -> int:
            return look

        def _status(self) -> None:
            for pod in list(self.resources.values()):
                if pod["status"].terminal:
                    continue
                try:
                    self.kube_client.read_namespaced_pod(name=pod["pod_name"], namespace=self.namespace)
                except ApiException as error:
                    if error.status == 404:
                        pod["status"] = JobStatus(JobState.FAILED, message=f"the pod {pod['pod_name']} is gone")
            super()._status()

        def _delete_pod(self, pod_name: str) -> None:
            try:
                super()._delete_pod(pod_name)
            except ApiException as error:
                if error.status != 404:
                    raise

    if pool.image is None:
        raise SettingsError("kubernetes: image: name a container image that holds e4dgs")
    cpu = float(pool.workers * (pool.cores or 1))
    memory = f"{math.ceil(1000 * pool.workers * (pool.memory_gb or USUAL_MEMORY_GB))}M"
    gpus = {"nvidia.com/gpu": str(pool.gpus)} if pool.gpus else {}
    try:
        return Pods(
            image=pool.image,
            namespace=pool.namespace,
            worker_init=pool.setup,
            nodes_per_block=1,
            init_blocks=1,
            min_blocks=0,
            max_blocks=pool.nodes,
            init_cpu=cpu,
            max_cpu=cpu,
            init_mem=memory,
            max_mem=memory,
            extra_requests=gpus,  # Kubernetes requires both to be equal
            extra_limits=gpus,
            persistent_volumes=list(pool.volumes),
        )
    except ConfigException as error:
        raise SettingsError(
            f"provider: kubernetes: no cluster is configured ({error}); let KUBECONFIG name a file that kubectl works with, "
            "or run e4dgs batch in a pod"
        ) from error
