"""A Slurm cluster on this host: slurmctld and two slurmd of the distribution's packages, in a scratch folder, without accounting and munge.
Licences stand for GPUs."""

import contextlib
import getpass
import os
import shutil
import signal
import socket
import subprocess
import time
from pathlib import Path
from typing import Any

import psutil
from toy_batch import wait

NODES = ("node1", "node2")
LOST_AFTER = 5  # s without a word from a slurmd
CONF = """
ClusterName=e4dgs
SlurmctldHost={host}(127.0.0.1)
SlurmctldPort={ports[0]}
SlurmUser={user}
SlurmdUser={user}
AuthType=auth/none
CredType=cred/none
AuthInfo=cred_expire=5
MpiDefault=none
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core_Memory
SchedulerParameters=sched_interval=2,bf_interval=2,batch_sched_delay=1
SlurmdParameters=config_overrides
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool-%n
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/%n.pid
SlurmdLogFile={folder}/%n.log
ReturnToService=2
SlurmdTimeout={lost}
CompleteWait=0
Licenses=gpu:4
NodeName=node1 NodeHostname={host} NodeAddr=127.0.0.1 Port={ports[1]} CPUs=4 RealMemory=8000
NodeName=node2 NodeHostname={host} NodeAddr=127.0.0.1 Port={ports[2]} CPUs=4 RealMemory=8000
PartitionName=main Nodes=node1,node2 Default=YES MaxTime=INFINITE State=UP
"""
PATH = f"{os.environ.get('PATH', '')}:/usr/sbin:/usr/local/sbin"


def missing() -> str:
    """Which program of Slurm is not installed, "" where all are."""
    return next((name for name in ("slurmctld", "slurmd", "sbatch", "scontrol") if shutil.which(name, path=PATH) is None), "")


class Slurm:
    """``environment``: with which programs find this cluster."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        sockets = [socket.create_server(("127.0.0.1", 0)) for _ in range(3)]
        ports = [one.getsockname()[1] for one in sockets]
        for one in sockets:
            one.close()
        conf = folder / "slurm.conf"
        conf.write_text(CONF.format(host=socket.gethostname(), ports=ports, user=getpass.getuser(), folder=folder, lost=LOST_AFTER))
        for name in ("state", *(f"spool-{node}" for node in NODES)):
            (folder / name).mkdir()
        self.environment = dict(os.environ, SLURM_CONF=str(conf), PATH=PATH)
        self._daemons: dict[str, subprocess.Popen[Any]] = {}
        self._daemon("slurmctld", "slurmctld", "-D", "-c")
        for node in NODES:
            self.start_node(node)
        wait(lambda: self.say("sinfo", "-h", "-N", "-o", "%T").split() == ["idle", "idle"], 60, "two idle nodes")

    def start_node(self, node: str) -> None:
        self._daemon(node, "slurmd", "-D", "-N", node)

    def kill_slurmd(self, node: str) -> None:
        """kill -9; what it has started goes on."""
        self._daemons[node].kill()
        self._daemons[node].wait()

    def switch_off(self, node: str) -> None:
        """All that runs on a node ends at once, and nobody is told."""
        self.kill_slurmd(node)
        for process in psutil.process_iter():
            with contextlib.suppress(psutil.Error):
                files = [file.path for file in process.open_files()] if process.name().startswith("slurmstepd") else []
                if str(self.folder / f"{node}.log") in files:  # slurmd's, which those that look after its jobs write to
                    for one in (process, *process.children(recursive=True)):
                        one.kill()

    def say(self, *words: str) -> str:
        """What a client program prints; "" where it fails."""
        return subprocess.run(words, env=self.environment, capture_output=True, text=True).stdout.strip()

    def jobs(self, states: str = "PD,CF,R,S,CG,RQ") -> list[dict[str, str]]:
        """id, name, state and node of the jobs in these states, arrays task by task; "all": also of those that have ended."""
        command = ["squeue", "-h", "-r", "-t", states, "-o", "%i|%j|%t|%N"]
        for _ in range(30):  # a busy controller does not answer, which must not look like no jobs
            answer = subprocess.run(command, env=self.environment, capture_output=True, text=True)
            if answer.returncode == 0:
                return [dict(zip(("id", "name", "state", "node"), row.split("|"))) for row in answer.stdout.splitlines()]
            time.sleep(1)
        raise AssertionError(f"squeue does not answer: {answer.stderr.strip()}")

    def close(self) -> None:
        for job in self.jobs():
            self.say("scancel", job["id"])
        for _ in range(50):
            if not self.jobs():
                break
            time.sleep(0.2)
        for daemon in self._daemons.values():
            daemon.send_signal(signal.SIGTERM)
        for daemon in self._daemons.values():
            try:
                daemon.wait(5)
            except subprocess.TimeoutExpired:
                daemon.kill()

    def _daemon(self, name: str, *words: str) -> None:
        with open(self.folder / f"{name}.out", "ab") as log:
            self._daemons[name] = subprocess.Popen(words, env=self.environment, stdout=log, stderr=log, stdin=subprocess.DEVNULL)
