"""Batches on a real Slurm cluster of two nodes, whose jobs and nodes are lost in every way: all scenes finish, and nothing that was
committed is computed twice."""

import subprocess
from pathlib import Path

import pytest
from slurm_cluster import Slurm, missing
from toy_batch import PATIENCE, ToyBatch, wait

SCENES = [f"scene{k}" for k in range(6)]
STEPS = 30  # of 0.1 s

pytestmark = [
    pytest.mark.skipif(bool(missing()), reason=f"needs {missing()}: apt-get install slurmctld slurmd slurm-client"),
    pytest.mark.timeout(1500),  # for machines that are busy with something else
]


@pytest.fixture(scope="module")
def slurm(tmp_path_factory):
    cluster = Slurm(tmp_path_factory.mktemp("slurm"))
    yield cluster
    cluster.close()


class Batch(ToyBatch):
    """Six captures, and a cluster's file with one GPU's licence a training job."""

    def __init__(self, folder: Path, slurm: Slurm, steps: int) -> None:
        self.slurm, self.file = slurm, folder / "slurm.yaml"
        super().__init__(folder, SCENES, steps, ["--executor", str(self.file)], slurm.environment)
        pool = "provider: slurm, cores: 1, memory_gb: 0.5, nodes: 2, partition: main"
        self.file.write_text(
            f"lost_after: 12\ncpu: {{{pool}, workers: 3}}\ngpu: {{{pool}, workers: 1, options: '#SBATCH --licenses=gpu:1 --requeue'}}\n"
        )

    def job(self, scene: str) -> dict[str, str]:
        """The job that trains a scene, of the first array."""
        return next(job for job in self.slurm.jobs("all") if job["name"] == "e4dgs-train" and job["id"].endswith(f"_{SCENES.index(scene)}"))

    def unfinished(self) -> list[str]:
        return [scene for scene in SCENES if self.ledger.progress(scene).state != "done"]

    def story(self) -> str:
        """What a failure on another machine is read from: each scene's progress, its jobs, and the end of what these said."""
        lines = [f"{scene}: {self.ledger.progress(scene)}" for scene in SCENES] + [str(job) for job in self.slurm.jobs("all")]
        for file in sorted((self.ledger.folder / "slurm").glob("*.out")):
            lines += [f"-- {file.name}", *file.read_text().splitlines()[-12:]]
        return "\n".join(lines)


def submit(batch: Batch) -> None:
    assert batch.start("--emit", "slurm").wait(PATIENCE) == 0, batch.said()
    subprocess.run([str(batch.ledger.folder / "slurm" / "submit.sh")], env=batch.environment, check=True, stdout=subprocess.DEVNULL)


def test_job_scripts_survive_what_happens_to_jobs_and_nodes(slurm, tmp_path):
    batch = Batch(tmp_path, slurm, STEPS)
    batch.hold("scene0", "scene1", "scene2", "scene3")
    submit(batch)
    batch.trains("scene0")
    slurm.say("scontrol", "update", f"jobid={batch.job('scene0')['id']}", "EndTime=now+30")
    batch.trains("scene1")
    slurm.say("scontrol", "requeue", batch.job("scene1")["id"])
    batch.trains("scene2")
    slurm.say("scancel", batch.job("scene2")["id"])
    batch.trains("scene3")
    lost = batch.job("scene3")["node"]
    slurm.switch_off(lost)
    wait(lambda: "down" in slurm.say("sinfo", "-h", "-n", lost, "-o", "%T"), PATIENCE, "a node is missed")
    slurm.start_node(lost)
    batch.release("scene1", "scene3")
    said = batch.ledger.folder / "slurm" / f"e4dgs-train-{batch.job('scene0')['id']}.out"
    wait(lambda: "in a new job" in said.read_text(), PATIENCE, "a job meets its time limit")
    slurm.say("scontrol", "update", f"jobid={batch.job('scene0')['id']}", "TimeLimit=60")  # it was two minutes, too few for a busy machine
    batch.release("scene0")
    wait(lambda: not slurm.jobs(), PATIENCE, "all jobs end")
    assert batch.unfinished() == ["scene2"], batch.story()  # what was cancelled stays so
    batch.release("scene2")
    submit(batch)
    assert (batch.ledger.folder / "slurm" / "scenes.txt").read_text() == "scene2\n"
    wait(lambda: not slurm.jobs(), PATIENCE, "the rest ends")
    batch.check()
    assert (batch.ledger.folder / "results.csv").read_text().count("done") == 6, "written by the last job"


def test_parsl_survives_what_happens_to_its_jobs_and_nodes(slurm, tmp_path):
    pytest.importorskip("parsl")
    batch = Batch(tmp_path, slurm, STEPS)
    batch.hold(*SCENES)
    head = batch.start()

    def training() -> list[dict[str, str]]:
        return [job for job in slurm.jobs("R") if "gpu" in job["name"]]

    try:
        wait(lambda: len(training()) == 2 and any(batch.events(name, "coarse step") for name in SCENES), PATIENCE, "two jobs that train")
        first, second = training()
        slurm.say("scancel", first["id"])
        slurm.say("scontrol", "requeue", second["id"])
        wait(lambda: {job["id"] for job in training()} - {first["id"], second["id"]}, PATIENCE, "a job in the place of the cancelled one")
        lost = training()[-1]["node"]
        slurm.kill_slurmd(lost)
        wait(lambda: "down" in slurm.say("sinfo", "-h", "-n", lost, "-o", "%T"), PATIENCE, "a node is missed")
        slurm.start_node(lost)
        batch.release(*SCENES)
        assert head.wait(PATIENCE) == 0, batch.said()
    finally:
        head.terminate()
        head.wait(60)
    batch.check()
    wait(lambda: not slurm.jobs(), PATIENCE, "no job is left behind")


def test_a_pool_that_gets_no_jobs_fails_its_scenes_with_the_message_of_slurm(slurm, tmp_path):
    pytest.importorskip("parsl")
    batch = Batch(tmp_path, slurm, 1)
    batch.file.write_text(batch.file.read_text().replace("partition: main", "partition: nowhere"))
    assert batch.start().wait(PATIENCE) == 1
    assert batch.states() == {"failed": 6} and "invalid partition" in batch.ledger.progress("scene0").message
