"""`e4dgs batch --emit slurm`: plain job scripts, for sites that do not allow a process that keeps running."""

from __future__ import annotations

import math
import shlex
import sys
from pathlib import Path

from ..ledger import Ledger
from ..work import PARTS
from .pools import Cluster, Pool

MOST_TASKS = 1000  # of an array; Slurm's default limit is 1001
USUAL = Pool.model_validate({"provider": "slurm", "cores": 8, "memory_gb": 16, "walltime": "08:00:00"})
USUAL_GPU = USUAL.model_copy(update={"options": "#SBATCH --gres=gpu:1"})

SCRIPT = """#!/bin/bash
#SBATCH --job-name=e4dgs-{part}
#SBATCH --output={logs}/%x-%A_%a.out
#SBATCH --open-mode=append
#SBATCH --requeue
#SBATCH --signal=B:USR1@60
#SBATCH --kill-on-invalid-dep=yes
{wants}
# A stage whose result is there is not computed again, so a job that was requeued goes on where it was.
{setup}
scene=$(sed -n "$((${{E4DGS_FIRST:-0}} + SLURM_ARRAY_TASK_ID + 1))p" {scenes})
export OMP_NUM_THREADS=${{SLURM_CPUS_PER_TASK:-1}} OPENCV_FOR_THREADS_NUM=${{SLURM_CPUS_PER_TASK:-1}}
exec {python} -m e4dgs.workflows.batch.sites.job {workspace} {batch} "$scene" {part}{timeout}
"""
RESULTS = """#!/bin/bash
#SBATCH --job-name=e4dgs-results
#SBATCH --output={logs}/%x-%j.out
{wants}
{setup}
exec {python} -m e4dgs.workflows.batch.summary {workspace} {batch}
"""
SUBMIT = """#!/bin/bash
# Each scene's part waits for its part before (aftercorr); the scenes do not wait for one another.
set -e
cd "$(dirname "$0")"
ends=
for first in $(seq 0 {most} {last}); do
  tasks="--array=0-$(( {last} - first < {most} ? {last} - first : {most} - 1 )) --export=ALL,E4DGS_FIRST=$first"
  before=$(sbatch --parsable $tasks before.sbatch)
  train=$(sbatch --parsable $tasks --dependency=aftercorr:${{before%%;*}} train.sbatch)
  after=$(sbatch --parsable $tasks --dependency=aftercorr:${{train%%;*}} after.sbatch)
  ends=$ends:${{after%%;*}}
done
sbatch ${{ends:+--dependency=afterany$ends}} results.sbatch
"""


def emit(ledger: Ledger, cluster: Cluster, timeout: float | None = None) -> Path:
    """Writes ``slurm/`` to the batch's folder: a script for each part, one for the results, `submit.sh`, and a list of the unfinished
    scenes, one per line. timeout: seconds for each stage. Returns the folder."""
    folder = ledger.folder / "slurm"
    folder.mkdir(parents=True, exist_ok=True)
    names = [entry.name for entry in ledger.entries() if ledger.progress(entry.name).state != "done"]
    scenes = folder / "scenes.txt"
    scenes.write_text("".join(f"{name}\n" for name in names), encoding="utf-8")
    quoted = {"logs": folder, "scenes": scenes, "workspace": ledger.workspace, "python": sys.executable}
    common = {
        "batch": shlex.quote(ledger.name),
        "timeout": "" if timeout is None else f" {timeout}",
        **{key: shlex.quote(str(path)) for key, path in quoted.items()},
    }
    texts = {}
    for part in PARTS:
        pool = cluster.pool(part)
        texts[f"{part}.sbatch"] = SCRIPT.format(part=part, wants=_wants(pool), setup=pool.setup, **common)
    small = cluster.cpu.model_copy(update={"cores": 1, "memory_gb": 2, "walltime": "00:30:00"})
    texts["results.sbatch"] = RESULTS.format(wants=_wants(small), setup=small.setup, **common)
    texts["submit.sh"] = SUBMIT.format(most=MOST_TASKS, last=len(names) - 1)
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
        (folder / name).chmod(0o755)
    return folder


def _wants(pool: Pool) -> str:
    memory = None if pool.memory_gb is None else f"{math.ceil(1000 * pool.memory_gb)}M"
    wanted = {"cpus-per-task": pool.cores or 1, "mem": memory, "time": pool.walltime, "partition": pool.partition, "account": pool.account}
    lines = [f"#SBATCH --{name}={value}" for name, value in wanted.items() if value is not None]
    return "\n".join([*lines, *([pool.options.strip()] if pool.options.strip() else [])])
