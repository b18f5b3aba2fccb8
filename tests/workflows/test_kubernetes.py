"""Batches on Kubernetes: what is asked of a cluster, and that pods, here processes of this host, do the work. No cluster takes part."""

import builtins
import copy
import os
import re
import subprocess
import sys
from pathlib import Path

import e4dgs.workflows
import pytest
from e4dgs.pipeline import SettingsError
from e4dgs.workflows.batch.ledger import Ledger
from e4dgs.workflows.batch.sites.cluster import _provider, read_cluster
from e4dgs.workflows.batch.sites.pools import Pool
from PIL import Image
from pod_server import PodServer
from slurm_cluster import wait

pytest.importorskip("parsl")
client = pytest.importorskip("kubernetes.client")
from kubernetes.config import kube_config  # noqa: E402

SHIPPED = Path(e4dgs.workflows.__file__).parent / "clusters" / "kubernetes.yaml"
PATIENCE = 200.0  # s; for machines that are busy with something else
QUANTITY = re.compile(r"\d+(\.\d+)?(m|[kMGTPE]|[KMGTPE]i)?")  # kubernetes.io, "Resource units in Kubernetes"
LABEL = re.compile(r"[a-z0-9]([-a-z0-9]{0,61}[a-z0-9])?")  # kubernetes.io, "Object names and IDs"


def check(pod: dict) -> None:
    """That an API server would take it: fields and their types, by the client's classes, which are made from the published schema; and what
    the schema does not say of names and quantities."""
    client.V1Pod.model_validate(pod)
    assert all(LABEL.fullmatch(part) for part in pod["metadata"]["name"].split(".")) and len(pod["metadata"]["name"]) <= 253
    (container,) = pod["spec"]["containers"]
    mounts = [mount["name"] for mount in container.get("volumeMounts", ())]
    volumes = [volume["name"] for volume in pod["spec"].get("volumes", ())]
    assert mounts == volumes and all(LABEL.fullmatch(name) for name in (container["name"], *volumes))
    wanted = container["resources"]
    assert all(QUANTITY.fullmatch(value) for kind in ("requests", "limits") for value in wanted[kind].values())


@pytest.fixture
def server(tmp_path, monkeypatch):
    server = PodServer()
    monkeypatch.setattr(kube_config, "KUBE_CONFIG_DEFAULT_LOCATION", str(server.config(tmp_path)))
    yield server
    server.close()


def pod_of(server: PodServer, pool: Pool) -> dict:
    """That Parsl asks for when it starts a pool's workers."""
    _provider(pool, 120).submit("process_worker_pool.py --port=1", 1, "parsl.cpu.block-0")
    return server.pods[-1]


def test_pods_of_the_file_that_comes_along_fit_the_schema(server):
    cluster = read_cluster(SHIPPED)
    assert cluster.gpu is not None
    for pool in (cluster.cpu, cluster.gpu):
        pod = pod_of(server, pool)
        check(pod)
        (container,) = pod["spec"]["containers"]
        wanted = {"cpu": f"{pool.workers * pool.cores}.0", "memory": f"{1000 * pool.workers * pool.memory_gb:.0f}M"}
        wanted |= {"nvidia.com/gpu": str(pool.gpus)} if pool.gpus else {}
        assert container["resources"]["requests"] == container["resources"]["limits"] == wanted
        assert container["image"] == pool.image and pod["metadata"]["namespace"] == pool.namespace
        assert [(one["name"], one["mountPath"]) for one in container["volumeMounts"]] == pool.volumes
        assert [one["persistentVolumeClaim"]["claimName"] for one in pod["spec"]["volumes"]] == [claim for claim, _ in pool.volumes]
    assert (cluster.cpu.gpus, cluster.gpu.gpus) == (0, 1)


def test_a_pool_that_says_little_gets_pods_that_can_work(server):
    pod = pod_of(server, Pool(provider="kubernetes", image="e4dgs", workers=3, memory_gb=0.1, setup="export A='1 2'"))
    check(pod)
    (container,) = pod["spec"]["containers"]
    assert container["resources"]["limits"] == {"cpu": "3.0", "memory": "300M"}, "less than a GB is not none"
    assert container["args"][0] == "-c" and "export A='1 2'\n" in container["args"][1]


def test_the_check_of_pods_finds_what_is_wrong(server):
    good = pod_of(server, Pool(provider="kubernetes", image="e4dgs", volumes=[("claim", "/data")]))
    check(good)
    for path, value in (
        (("spec", "containers", 0, "resources", "limits", "cpu"), 8.0),
        (("spec", "containers", 0, "resources", "limits", "memory"), "16 GB"),
        (("spec", "containers", 0, "resources", "limit"), {}),
        (("spec", "containers", 0, "volumeMounts", 0, "name"), "other"),
        (("spec", "containers"), None),
        (("metadata", "name"), "Parsl_cpu"),
    ):
        bad = copy.deepcopy(good)
        place = bad
        for key in path[:-1]:
            place = place[key]
        place[path[-1]] = value
        with pytest.raises((ValueError, AssertionError)):
            check(bad)


def test_a_pod_that_is_gone_has_failed_and_can_be_ended(server):
    provider = _provider(Pool(provider="kubernetes", image="e4dgs"), 120)
    job = provider.submit("process_worker_pool.py", 1)
    assert [one.state.name for one in provider.status([job])] == ["RUNNING"]
    server.end(*server.names())
    assert provider.cancel([job]) == [True]
    other = provider.submit("process_worker_pool.py", 1)
    server.end(*server.names())
    (status,) = provider.status([other])
    assert status.state.name == "FAILED" and "is gone" in status.message


def test_without_the_package_the_command_that_installs_it_is_named(monkeypatch):
    real = builtins.__import__

    def without(name, *rest, **more):
        if name.split(".")[0] == "kubernetes":
            raise ImportError(name)
        return real(name, *rest, **more)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(SettingsError, match=r"pip install 'e4dgs\[kubernetes\]'"):
        _provider(Pool(provider="kubernetes", image="e4dgs"), 120)


def test_without_a_cluster_the_message_says_how_to_name_one(tmp_path, monkeypatch):
    monkeypatch.setattr(kube_config, "KUBE_CONFIG_DEFAULT_LOCATION", str(tmp_path / "none"))
    monkeypatch.delenv("KUBERNETES_SERVICE_HOST", raising=False)
    with pytest.raises(SettingsError, match="KUBECONFIG") as told:
        _provider(Pool(provider="kubernetes", image="e4dgs"), 120)
    assert "\n" not in str(told.value)
    with pytest.raises(SettingsError, match="image: name a container image"):
        _provider(Pool(provider="kubernetes"), 120)


@pytest.mark.timeout(900)
def test_a_scene_whose_pod_is_evicted_goes_on_in_another_one(tmp_path):
    """The real client, Parsl and its workers; of the cluster only the API server's answers about pods are imitated."""
    capture, events = tmp_path / "scene", tmp_path / "events"
    capture.mkdir()
    events.mkdir()
    (events / "scene.hold").touch()
    for i in range(2):
        Image.new("RGB", (16, 12), (40 * i, 0, 0)).save(capture / f"{i}.png")
    toys = Path(__file__).parent / "toy_site"
    path = os.pathsep.join([str(toys), *filter(None, [os.environ.get("PYTHONPATH")])])
    setup = f"export PATH={Path(sys.executable).parent}:$PATH PYTHONPATH={path}"
    pool = f"{{provider: kubernetes, image: e4dgs, nodes: 1, address: 127.0.0.1, setup: '{setup}'}}"
    (tmp_path / "cluster.yaml").write_text(f"retries: 0\nlost_after: 4\ncpu: {pool}\n")
    words = ["batch", str(capture), "--workspace", str(tmp_path / "work"), "--executor", str(tmp_path / "cluster.yaml")]
    words += ["--set", "coarse.iterations=2", "--set", "coarse.seconds=0.01"]
    server = PodServer(run=True)
    try:
        environment = dict(os.environ, PYTHONPATH=path, KUBECONFIG=str(server.config(tmp_path)))
        with open(tmp_path / "head.txt", "wb") as log:
            head = subprocess.Popen([sys.executable, "-m", "e4dgs.workflows.cli", *words], env=environment, stdout=log, stderr=log)
        told = events / "scene.txt"
        wait(lambda: told.exists() and "coarse step" in told.read_text(), PATIENCE, "a pod trains")
        (name,) = server.names()
        server.end(name)
        (events / "scene.hold").unlink()
        assert head.wait(PATIENCE) == 0, (tmp_path / "head.txt").read_text()
        assert server.names() == [], "no pod is left behind"
    finally:
        head.terminate()
        head.wait(PATIENCE)
        server.close()
    for pod in server.pods:
        check(pod)
    progress = Ledger(tmp_path / "work", "batch").progress("scene")
    assert len(server.pods) >= 2 and (progress.state, progress.attempts) == ("done", 1)
    assert told.read_text().count("coarse step") == 2, "and it went on from its checkpoint"
