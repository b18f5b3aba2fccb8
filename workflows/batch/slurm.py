"""`e4dgs batch --emit slurm`: plain job scripts, for sites that allow no process that stays."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path

from .ledger import Ledger
from .work import PARTS

SCRIPT = """#!/bin/bash
#SBATCH --job-name=e4dgs-{part}
#SBATCH --array=0-{last}
#SBATCH --output={logs}/%x-%a.out
#SBATCH --cpus-per-task=8
#SBATCH --mem=16G
#SBATCH --time=08:00:00
#SBATCH --requeue
{gpu}
# A stage whose result is there is not computed again, so a job that was requeued goes on where it was.
scene=$(sed -n "$((SLURM_ARRAY_TASK_ID + 1))p" {scenes})
export OMP_NUM_THREADS=${{SLURM_CPUS_PER_TASK:-1}}
exec {python} -m e4dgs.workflows.batch.work {workspace} {batch} "$scene" {part}
"""
SUBMIT = """#!/bin/bash
# Each scene's part waits for its part before (aftercorr); the scenes do not wait for one another.
set -e
cd "$(dirname "$0")"
before=$(sbatch --parsable before.sbatch)
train=$(sbatch --parsable --dependency=aftercorr:$before train.sbatch)
sbatch --dependency=aftercorr:$train after.sbatch
"""


def emit(ledger: Ledger, gpu: bool) -> Path:
    """Writes ``slurm/`` into the batch's folder: a script for each part, `submit.sh`, and the scenes, one a line. Returns the folder."""
    folder = ledger.folder / "slurm"
    folder.mkdir(parents=True, exist_ok=True)
    names = [entry.name for entry in ledger.entries()]
    scenes = folder / "scenes.txt"
    scenes.write_text("\n".join(names) + "\n")
    for part in PARTS:
        wants = "#SBATCH --gres=gpu:1" if gpu and part == "train" else "#"
        values = {"part": part, "last": len(names) - 1, "gpu": wants, "python": sys.executable, "batch": ledger.name}
        quoted = {"logs": folder, "scenes": scenes, "workspace": ledger.workspace}
        text = SCRIPT.format(**values, **{key: shlex.quote(str(path)) for key, path in quoted.items()})
        (folder / f"{part}.sbatch").write_text(text)
    (folder / "submit.sh").write_text(SUBMIT)
    for file in folder.glob("*.s*"):
        if file.suffix in (".sh", ".sbatch"):
            file.chmod(0o755)
    return folder
