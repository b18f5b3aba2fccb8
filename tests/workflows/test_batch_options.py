"""Options of `e4dgs batch` reach whoever runs the stages; those that only this machine has are refused elsewhere."""

import os
import re
import subprocess
from pathlib import Path

import pytest
from e4dgs.workflows.batch.ledger import Ledger
from e4dgs.workflows.batch.sites.pools import Cluster, Pool
from e4dgs.workflows.cli import main


def test_job_scripts_end_a_stage_that_takes_too_long(dnerf_capture, tmp_path):
    """Run as Slurm would run the first task of the first array."""
    words = ["batch", str(dnerf_capture.root), "--workspace", str(tmp_path), "--emit", "slurm", "--device", "cpu"]
    assert main([*words, "--stage-timeout", "0.1"]) == 0
    scripts = tmp_path / "batches" / "batch" / "slurm"
    ran = subprocess.run(
        ["bash", str(scripts / "before.sbatch")], env=dict(os.environ, SLURM_ARRAY_TASK_ID="0"), capture_output=True, text=True
    )
    progress = Ledger(tmp_path, "batch").progress(dnerf_capture.root.name)
    assert ran.returncode == 1 and progress.message.startswith("ended after 0 s (--stage-timeout)"), ran.stderr
    assert (progress.state, progress.stage, progress.attempts) == ("failed", "frames", 1)


@pytest.mark.parametrize(
    ("option", "field"),
    [(("--jobs", "2"), "workers"), (("--jobs", "2"), "nodes"), (("--memory", "8"), "memory_gb"), (("--retries", "1"), "retries")],
)
def test_options_of_this_machine_name_what_to_set_in_the_file_of_a_cluster(tmp_path, option, field, capsys):
    file = tmp_path / "cluster.yaml"
    file.write_text("{}")
    assert main(["batch", str(tmp_path), "--workspace", str(tmp_path / "work"), "--executor", str(file), *option]) == 2
    said = capsys.readouterr().err
    assert option[0] in said and field in said and str(file) in said and said.count("\n") == 1
    assert field in Cluster.model_fields or field in Pool.model_fields
    assert not (tmp_path / "work").exists()


@pytest.mark.parametrize("option", [("--jobs", "2"), ("--memory", "8"), ("--retries", "0")])
def test_options_of_this_machine_are_not_for_job_scripts(tmp_path, option, capsys):
    assert main(["batch", str(tmp_path), "--workspace", str(tmp_path / "work"), "--emit", "slurm", *option]) == 2
    said = capsys.readouterr().err
    assert option[0] in said and "--emit slurm" in said and said.count("\n") == 1


@pytest.mark.parametrize("pools", ["{}", "cpu: {provider: slurm}\ngpu: {provider: kubernetes, image: e4dgs}"])
def test_job_scripts_are_for_pools_of_slurm(tmp_path, pools, capsys):
    file = tmp_path / "cluster.yaml"
    file.write_text(pools)
    words = ["batch", str(tmp_path), "--workspace", str(tmp_path / "work"), "--emit", "slurm", "--executor", str(file)]
    assert main(words) == 2
    said = capsys.readouterr().err
    assert str(file) in said and ("kubernetes" if "kubernetes" in pools else "local") in said and "provider: slurm" in said
    assert not (tmp_path / "work").exists()


def test_the_page_names_every_field_of_a_cluster_file_and_its_default():
    page = (Path(__file__).resolve().parents[2] / "docs" / "batches.md").read_text()
    rows = re.findall(r"^\| `(\w+)` \| ([^|]*) \| [^|]+ \|$", page, re.MULTILINE)
    fields = Cluster.model_fields | Pool.model_fields
    assert [name for name, _ in rows] == list(fields)
    for name, said in rows:
        default = fields[name].get_default(call_default_factory=True)
        assert said == ("one local worker" if default == Pool() else str(default) if default or default == 0 else "none"), name
