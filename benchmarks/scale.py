"""Past one machine: a simulation of 10,000 scenes of seven stages on up to thousands of workers, fed with what was measured.

    python benchmarks/scale.py [--scenes 10000] [--out benchmarks/results/scale.json]

Each scene is one of those in benchmarks/results/stages.json (seconds of its stages on one thread; 0 where one was skipped), longer or
shorter by a factor drawn for each stage. A worker takes a scene, runs its stages in order, reads each stage's inputs from the store and
writes its result there; the store has a bandwidth that all share, and answers requests (one a file, so many at a time by a worker). Workers
are lost at random; what they did since the last checkpoint is done again by another.
"""

from __future__ import annotations

import argparse
import heapq
import json
import random
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

RESULTS = Path(__file__).resolve().parent / "results"
STAGES = ("frames", "poses", "flow", "coarse", "hulls", "fine", "evaluate")
INPUTS = {"coarse": ("frames", "flow"), "hulls": ("frames", "coarse"), "fine": ("frames", "flow", "coarse", "hulls")}
INPUTS |= {"flow": ("frames",), "poses": ("frames",), "evaluate": ("frames", "flow", "fine")}
# MB and files of each result, measured in three workspaces; other scenes take the nearest of kind: no flow, one camera, a rig.
STORED = {
    "lego": {"frames": (0.11, 19), "coarse": (4.30, 73), "hulls": (0.26, 11), "fine": (4.24, 83), "evaluate": (5.81, 11)},
    "room-mono": {"frames": (0.11, 19), "flow": (35.8, 481), "coarse": (9.93, 45), "hulls": (0.26, 11), "fine": (5.93, 51)},
    "basketball": {"frames": (0.13, 19), "flow": (218.1, 1647), "coarse": (5.65, 49), "hulls": (0.26, 11), "fine": (4.45, 55)},
}
STORED["room-mono"]["evaluate"], STORED["basketball"]["evaluate"] = (11.75, 11), (9.11, 11)
KIND = {"basketball": "basketball", "stage": "basketball", "lego": "lego", "robot": "lego", "sceaux-static": "lego"}
LEFT_OUT = ("lego-fast",)  # the same scene once more


@dataclass(frozen=True)
class Cluster:
    """workers: each one thread, as measured. start: seconds for a stage's process. spread: sigma of ln(factor) of a stage's time.
    lost: a worker's chance an hour. lost_work: seconds since the last checkpoint, and until it is begun anew.
    gigabits: of the store. request: seconds each; parallel: of one worker at a time. share: of scenes that are in the store already.
    order: "listed", "longest" first by an estimate that is off by ``spread``.
    """

    workers: int = 1000
    start: float = 1.5
    spread: float = 0.3
    lost: float = 0.01
    lost_work: float = 120.0
    gigabits: float = 10.0
    request: float = 0.03
    parallel: int = 16
    share: float = 0.0
    order: str = "longest"


def measured() -> dict[str, dict[str, float]]:
    found = json.loads((RESULTS / "stages.json").read_text())
    return {name: {s: row["seconds"][s] for s in STAGES} for name, row in found.items() if name not in LEFT_OUT}


def simulate(cluster: Cluster, scenes: int, seed: int = 0) -> dict[str, Any]:
    """Hours of wall time and of workers, what the store carried, and the least time that any schedule would take."""
    chance, times = random.Random(seed), measured()
    names = sorted(times)
    queue = []
    for _ in range(scenes):
        name = chance.choice(names)
        seconds = {s: t * chance.lognormvariate(0, cluster.spread) for s, t in times[name].items()}
        queue.append((name, seconds, chance.random() < cluster.share))
    if cluster.order == "longest":
        queue.sort(key=lambda job: -sum(job[1].values()) * chance.lognormvariate(0, cluster.spread))
    link = computed = moved = waited = again = busy = 0.0  # link: when the store's wire is free again
    requests, ends = 0, []
    waiting = iter(range(scenes))
    # When it happens, which scene, which stage, and whether that is computed and wants the store.
    events: list[tuple[float, int, int, bool]] = [(0.0, scene, 0, False) for _, scene in zip(range(cluster.workers), waiting)]
    while events:
        now, scene, k, computed_now = heapq.heappop(events)
        name, seconds, known = queue[scene]
        if k == len(STAGES):
            ends.append(now)
            if (following := next(waiting, None)) is not None:
                heapq.heappush(events, (now, following, 0, False))
            continue
        stage = STAGES[k]
        if seconds[stage] == 0 or known:
            heapq.heappush(events, (now + (0.0 if seconds[stage] == 0 else cluster.request), scene, k + 1, False))
        elif not computed_now:
            work = cluster.start + seconds[stage]
            if chance.random() < cluster.lost * work / 3600:
                work, again = work + cluster.lost_work, again + cluster.lost_work
            computed, busy = computed + seconds[stage], busy + work
            heapq.heappush(events, (now + work, scene, k, True))
        else:
            stored = STORED[KIND.get(name, "room-mono")]
            used = [stored[s] for s in (*INPUTS.get(stage, ()), stage) if s in stored]
            files, megabytes = sum(n for _, n in used), sum(mb for mb, _ in used)
            link = max(now, link) + megabytes * 8 / (cluster.gigabits * 1000)
            done = link + files * cluster.request / cluster.parallel
            moved, waited, busy, requests = moved + megabytes, waited + done - now, busy + done - now, requests + files
            heapq.heappush(events, (done, scene, k + 1, False))
    least = max(computed / cluster.workers, max(sum(s.values()) for _, s, known in queue if not known))
    hours = max(ends) / 3600
    return {
        "hours": hours,
        "worker_hours": busy / 3600,
        "computing_share": computed / busy,
        "busy_share": busy / 3600 / (hours * cluster.workers),
        "over_the_least": max(ends) / least,
        "store_terabytes_moved": moved / 1e6,
        "store_requests_millions": requests / 1e6,
        "store_wait_share": waited / busy,
        "done_again_hours": again / 3600,
    }


def table(rows: Mapping[str, Mapping[str, Any]]) -> str:
    """The rows as results/scale.md has them."""
    lines = [
        "| | wall hours | worker hours | busy | computing | waits for the store | over the least time |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, row in rows.items():
        shares = (f"{100 * row[key]:.0f} %" for key in ("busy_share", "computing_share", "store_wait_share"))
        cells = (name, f"{row['hours']:,.2f}", f"{row['worker_hours']:,.0f}", *shares, f"{row['over_the_least']:.2f}x")
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def said(result: Mapping[str, Any]) -> list[str]:
    """What else results/scale.md says in figures, as it has to say it."""
    scenes = [sum(seconds.values()) for seconds in result["measured_seconds"].values()]
    total, rows = sum(scenes), result["rows"]
    mean = total / len(scenes)
    share = {s: sum(seconds[s] for seconds in result["measured_seconds"].values()) / total for s in STAGES}
    rest = f"frames and hulls {share['frames'] + share['hulls']:.1%}".replace("%", " %")
    shares = (f"{s} {100 * share[s]:.{0 if share[s] > 0.1 else 1}f} %" for s in ("coarse", "fine", "poses", "flow", "evaluate"))
    usual, listed, many = rows["1000 workers"], rows["1000, listed order"], rows["3000 workers"]
    gigabits = 8e6 * usual["store_terabytes_moved"] / result["scenes"] / 1000
    over, over_many = (f"{100 * (row['over_the_least'] - 1):.0f} %" for row in (usual, many))
    narrow, one_by_one, lost = rows["1000, store of 1 Gbit/s"], rows["1000, requests one by one"], rows["1000, a tenth lost an hour"]
    serial = 100 * (one_by_one["hours"] / usual["hours"] - 1)
    return [
        f"| a scene, all stages, one thread | {min(scenes):,.0f} to {max(scenes):,.0f} s, mean {mean:,.0f} s |",
        f"| of that | {', '.join(shares)}, {rest} |",
        f"{result['scenes']:,} scenes are {mean * result['scenes'] / 3600:,.0f} hours of one thread",
        f"{over} over the least time at 1,000 workers and {over_many} at 3,000",
        f"Longest first is worth {100 * (1 - usual['hours'] / listed['hours']):.0f} % of the wall time at 1,000",
        f"All scenes move {usual['store_terabytes_moved']:.1f} TB",
        f"it takes {narrow['hours'] / usual['hours']:.1f} times as long with 1,000 of them",
        f"Gbit/s x {mean:,.0f} s / {gigabits:.1f} Gbit, about {round(mean / gigabits, -1):,.0f} for each",
        f"{usual['store_requests_millions']:.0f} million of them cost {serial:.0f} % of the wall time",
        f"{lost['done_again_hours']:.0f} of {lost['worker_hours']:,.0f} hours are done again",
        f"W = {usual['worker_hours']:,.0f} / {result['scenes']:,} = {usual['worker_hours'] / result['scenes']:.2f} of one thread",
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=10_000)
    parser.add_argument("--out", type=Path, default=RESULTS / "scale.json")
    args = parser.parse_args()
    rows = {f"{workers} workers": {"workers": workers} for workers in (2, 100, 1000, 3000)}
    rows |= {"1000, listed order": {"order": "listed"}, "1000, half known": {"share": 0.5}, "1000, a tenth lost an hour": {"lost": 0.1}}
    rows |= {"1000, store of 1 Gbit/s": {"gigabits": 1.0}, "3000, store of 1 Gbit/s": {"workers": 3000, "gigabits": 1.0}}
    rows |= {"1000, requests one by one": {"parallel": 1}}
    result: dict[str, Any] = {"scenes": args.scenes, "measured_seconds": measured(), "defaults": vars(Cluster()), "rows": {}}
    for name, changed in rows.items():
        found = simulate(Cluster(**changed), args.scenes)  # type: ignore[arg-type]
        result["rows"][name] = {"changed": changed} | {key: float(f"{value:.3g}") for key, value in found.items()}
        print(name, result["rows"][name])
    args.out.write_text(json.dumps(result, indent=1) + "\n")
    print(table(result["rows"]), *said(result), sep="\n")


if __name__ == "__main__":
    main()
