"""The commands that README and docs/ print, and what a test adds to each so that it ends within seconds."""

import re
import shlex
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGES = ["README.md", "benchmarks/README.md", *(str(page.relative_to(ROOT)) for page in sorted((ROOT / "docs").glob("*.md")))]

# Budgets under which a run takes seconds. All presets are one with them, so that commands find one another's results.
SETTINGS = {
    "coarse.iterations": 80,
    "coarse.effort": 1,
    "train.motion": "nodes",
    "seeds.count": 300,
    "train.budget": 400,
    "hulls.budget": 4,
    "fine.iterations": 3,
    "evaluate.movie_frames": 0,
    "evaluate.player": "false",
}
TINY = " ".join(f"--set {key}={value}" for key, value in SETTINGS.items()) + " --device cpu"
SAMPLE = f"{TINY} --set train.motion=planes"  # control nodes look for parts that turn, which takes half a minute there
SHORT = "--rows garden --repeats 1 --seconds 0"  # of `bench`
NOTHING = ""
PLANNED = SAMPLE.replace(" --set fine.iterations=3", "")

# What is put behind a command as printed; for options that are there twice, the later one counts.
RUN = {
    # README.md
    "python3 dev.py sample": f"--workspace e4dgs-workspace {SAMPLE}",
    "python3 dev.py test": "-p no:cacheprovider tests/test_sample.py",
    "e4dgs plan CAPTURE": TINY,
    "e4dgs run all CAPTURE": TINY,
    "e4dgs view CAPTURE": f"{TINY} --no-browser",
    "e4dgs run all clip.mp4": TINY,
    "e4dgs run all photos/ --static --set frames.max_size=800": TINY,
    "e4dgs run all data/dnerf/lego --preset fast": SAMPLE,
    "e4dgs run all data/n3v/coffee_martini --set frames.max_frames=60": TINY,
    "e4dgs batch captures/*.mp4 --name night": TINY,
    # docs/batches.md
    "e4dgs batch captures/*.mp4 --name night --preset fast": TINY,
    "e4dgs status": NOTHING,
    # docs/benchmarks.md
    "e4dgs bench raster --garden test_garden.npz": SHORT,
    "e4dgs bench field": "--rows field --scale 0.001 --repeats 1 --seconds 0",
    "e4dgs bench step --capture CAPTURE": "--rows split --scale 0.001 --repeats 1 --seconds 0",
    "e4dgs bench raster --list": NOTHING,
    "e4dgs bench raster --scale 0.05": f"{SHORT} --scale 0.001",
    "e4dgs bench pipeline CAPTURE... --plot FILE.svg": f"{TINY} --points default",
    # docs/comparing.md
    "e4dgs bench ablation CAPTURE --seeds 3 --out ablation/": f"{TINY} --seeds 1 --rows full",
    # docs/first-scene.md
    "e4dgs view samples/cube_and_ball": f"{SAMPLE} --no-browser",
    "e4dgs plan samples/cube_and_ball --preset fast": SAMPLE,
    "e4dgs plan samples/cube_and_ball --preset fast --set fine.iterations=600": PLANNED,
    # docs/hardware.md
    "e4dgs run all CAPTURE --time 10m": TINY,
    # docs/reproduce.md
    "e4dgs run all data/n3v/coffee_martini --set frames.max_size=1352 --set evaluate.measured=300": TINY,
    "e4dgs run all data/hypernerf/vrig-chicken --set frames.max_size=960 --set evaluate.measured=1000": TINY,
    "e4dgs run all data/nvidia/Balloon1_split": TINY,
    "e4dgs run all data/iphone/apple --set frames.max_size=480 --set evaluate.measured=1000": TINY,
    "e4dgs run all data/panoptic/basketball --set evaluate.measured=600": TINY,
    "e4dgs run all data/dnerf/lego --set frames.background=black": SAMPLE,
    # docs/reruns.md
    "e4dgs run all CAPTURE --set fine.iterations=3000": f"{TINY} --set fine.iterations=4",
    "e4dgs run flow CAPTURE": TINY,
    "e4dgs run coarse CAPTURE --force": TINY,
    "e4dgs why coarse CAPTURE": TINY,
    "e4dgs store list": NOTHING,
    "e4dgs store show SCENE coarse": NOTHING,
    "e4dgs store diff SCENE/fine OTHER/fine": NOTHING,
    "e4dgs store gc --dry-run": NOTHING,
    "e4dgs store gc --keep-bytes 10G --older-than 30d": NOTHING,
    "e4dgs store pin SCENE": NOTHING,
    # docs/results.md
    "e4dgs render CAPTURE --path spiral --out scene.mp4": f"{TINY} --frames 5",
    "e4dgs render CAPTURE --path turntable --time 0.5 --out pictures/ --depth": f"{TINY} --frames 5",
    "e4dgs render CAPTURE --path capture --seconds 10 --alpha --out cutout/": f"{TINY} --fps 1",
    "e4dgs export ply CAPTURE --times 30 --out DIR": f"{TINY} --times 2",
    "e4dgs export ply CAPTURE --time 0.5 --out one.ply": TINY,
    "e4dgs export 4dgs CAPTURE --out scene.4dgs": TINY,
    "e4dgs export ply CAPTURE --freetime --out scene.ftgs.ply": TINY,
    "e4dgs export gltf CAPTURE": f"{TINY} --times 2",
    "e4dgs export spz CAPTURE": f"{TINY} --times 2",
    "e4dgs export web CAPTURE --out scene.html": TINY,
    "e4dgs export web CAPTURE --out site/": TINY,
    "e4dgs export usd CAPTURE --out scene.usdc": f"{TINY} --times 2",
    "e4dgs export cameras CAPTURE --out cameras.json": TINY,
    "e4dgs export mesh CAPTURE --time 0.5 --out scene.glb": TINY,
    "e4dgs export mesh CAPTURE --convexes --out hulls.glb": TINY,
    "e4dgs export flow CAPTURE --out DIR": TINY,
}

SPLITS = "tests/test_reproduce.py and the place of tests/test_run_printed_commands.py do it"
ROWS = "runs for minutes; tests/benchmarks/test_bench_rows.py runs every row at a tiny size"
REAL = "measures real captures for minutes; only its words are checked"
PARSED_ONLY = {
    "sudo apt install g++ python3-dev python3-venv": "changes the machine",
    "python3 dev.py wheel": "compiles for minutes; CONTRIBUTING.md says when to run it with --check, which also installs and uses it",
    "pip install e4dgs-*.whl": "downloads; `python3 dev.py wheel --check` does it",
    "source .venv/bin/activate": "a shell's own; the environment is made by `python3 dev.py sample`, which downloads",
    "e4dgs bench cuda --garden test_garden.npz": "needs a GPU; tests/workflows/test_bench.py runs its rows on a pretended one",
    "python benchmarks/bench.py raster --garden test_garden.npz": ROWS,
    "python benchmarks/knobs.py": "compiles the kernels a dozen times",
    "python benchmarks/flow.py SCENES --weights DIR": "needs weights that are downloaded",
    "python benchmarks/moving.py SCENES": REAL,
    "python benchmarks/published_splits.py without data/n3v/coffee_martini_all cam13 data/n3v/coffee_martini": SPLITS,
    "python benchmarks/published_splits.py nvidia data/nvidia/Balloon1 data/nvidia/Balloon1/truth data/nvidia/Balloon1_split": SPLITS,
    "python benchmarks/published_splits.py nvidia SCENE TRUTH OUT": SPLITS,
    "python benchmarks/flow_terms.py SCENES": REAL,
    "python benchmarks/sfm_moving.py SCENES": REAL,
    "python benchmarks/zoom.py SCENE CAPTURE": "needs a trained scene and its capture",
    "python benchmarks/viewer.py CAPTURE": "needs Chromium and a trained scene",
    "python benchmarks/exports.py WORKSPACE": "needs programs from npm and a trained scene",
    "python benchmarks/overhead.py": "runs for minutes; tests/pipeline/test_overhead.py measures the same at a small size",
    "python benchmarks/captures.py SCENES": REAL,
    "python benchmarks/throughput.py": "trains twelve scenes three times",
    "python benchmarks/publish.py SCENES": REAL,
    "python benchmarks/scale.py": "writes a result that is committed; tests/test_scale.py runs it at a small size",
    "python benchmarks/publish.py --check": "tests/test_documents.py runs it",
    "python benchmarks/cuda_resources.py": "compiles every kernel, and writes a result that is committed",
}


def lines_of(page: str) -> list[list[str]]:
    """The words of every line in the page's blocks of bash, comments left out."""
    blocks = re.findall(r"```bash\n(.*?)```", (ROOT / page).read_text(), re.DOTALL)
    lines = [line for block in blocks for line in block.replace("\\\n", " ").splitlines()]
    return [words for line in lines if (words := shlex.split(line, comments=True))]


def printed() -> dict[str, list[str]]:
    """Every command once, and the pages that print it."""
    found: dict[str, list[str]] = {}
    for page in PAGES:
        for words in lines_of(page):
            found.setdefault(" ".join(words), []).append(page)
    return found
