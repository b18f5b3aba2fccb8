"""Small synthetic captures, one of every layout, for all tests.

Each fixture is a `factory.Capture`: `.root` is the path, `.views` and `.synthetic` are the truth. They are shared by the whole
session, so tests only read them; who wants to damage a capture copies it first (`shutil.copytree(capture.root, tmp_path / "bad")`)
or makes an own one with `factory.make` and a writer.
"""

import gc
import sys
from collections.abc import Generator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parent))  # importlib mode leaves sys.path alone, and `factory` is shared

from factory import (
    Capture,
    Options,
    make,
    write_colmap,
    write_dnerf,
    write_images,
    write_n3v,
    write_nerfies,
    write_nerfstudio,
    write_panoptic,
    write_video,
    write_videos,
)

# These take a minute or more, mostly waiting. They begin first, or a process would be left with one of them when all others have ended.
LONGEST = ("test_slurm", "test_run_printed_commands", "test_batch", "test_killed", "test_player_page", "test_crash", "test_own_footage")

SHARED = Path(__file__).resolve().parents[1].parent / "shared"


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--kernels",
        choices=("cpu", "cuda"),
        default="cpu",
        help="which kernels the tests of tests/stress hold against the reference; cuda: on a GPU where there is one, else emulated; "
        "and compile the CUDA kernels for every architecture",
    )


@pytest.hookimpl(wrapper=True)
def pytest_collection(session: pytest.Session) -> Generator[None, object, object]:
    """Hundreds of modules and thousands of tests stay to the end. The garbage collector would look at all of them again and again, both
    while they come and, unless they are frozen, in every test that makes many objects."""
    gc.disable()
    try:
        result = yield
    finally:
        gc.enable()
    gc.collect()
    gc.freeze()
    return result


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Puts the longest files first. Tests marked `cuda` are left out, not skipped, where the CUDA kernels cannot be used: nothing is
    missing there."""
    items.sort(key=lambda item: LONGEST.index(item.path.stem) if item.path.stem in LONGEST else len(LONGEST))
    marked = [item for item in items if item.get_closest_marker("cuda")]
    if marked:
        from e4dgs.rasterizer.cuda.runtime.available import why_not

        if why_not() is not None:
            config.hook.pytest_deselected(items=marked)
            items[:] = [item for item in items if item not in marked]


@pytest.fixture(scope="session")
def shared_scenes() -> Path:
    """The folder of real captures beside the repository; tests that need it skip where it is absent."""
    if not (SHARED / "scenes").is_dir():
        pytest.skip("needs the captures in ../shared/scenes, which are not part of the repository")
    return SHARED / "scenes"


@pytest.fixture
def emulated(request: pytest.FixtureRequest) -> None:
    """Where the emulator's kernels cannot be compiled, only tests marked `cuda` run."""
    from simt import why_not

    if why_not() and not request.node.get_closest_marker("cuda"):
        pytest.skip(why_not())


@pytest.fixture
def one_thread() -> Generator[None]:
    """For small tensors, with which several threads would only wait for one another."""
    import torch

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


@pytest.fixture(scope="session")
def dnerf_capture(tmp_path_factory: pytest.TempPathFactory) -> Capture:
    """12 train, 2 val, 4 test RGBA views of 64x64, a new camera at every time."""
    return write_dnerf(make(Options()), tmp_path_factory.mktemp("dnerf"))


@pytest.fixture(scope="session")
def n3v_capture(tmp_path_factory: pytest.TempPathFactory) -> Capture:
    """4 fixed synchronised cameras x 6 times, 80x64; camera 0 is the test camera."""
    options = Options(backdrop="room", rig="arc", cameras=4, times=6, width=80, height=64, samples=3, fov_degrees=60.0)
    return write_n3v(make(options), tmp_path_factory.mktemp("n3v"))


@pytest.fixture(scope="session")
def panoptic_capture(tmp_path_factory: pytest.TempPathFactory) -> Capture:
    """4 fixed synchronised cameras x 4 times, 80x64, with masks of what moves; camera 0 is the test camera."""
    options = Options(backdrop="room", rig="arc", cameras=4, times=4, width=80, height=64, samples=3, fov_degrees=60.0, seed=1)
    return write_panoptic(make(options), tmp_path_factory.mktemp("panoptic"))


@pytest.fixture(scope="session")
def nerfstudio_capture(tmp_path_factory: pytest.TempPathFactory) -> Capture:
    """One moving camera with lens distortion, 10 times, 80x64."""
    options = Options(
        backdrop="room", rig="path", times=10, width=80, height=64, samples=3, fov_degrees=60.0, distortion=(-0.06, 0.01, 0.001, -0.0005)
    )
    return write_nerfstudio(make(options), tmp_path_factory.mktemp("nerfstudio"))


@pytest.fixture(scope="session")
def nerfies_capture(tmp_path_factory: pytest.TempPathFactory) -> Capture:
    """Nerfies: one moving camera with lens distortion, 9 times, 80x64, every third held out."""
    options = Options(
        backdrop="room",
        rig="path",
        times=9,
        width=80,
        height=64,
        samples=3,
        fov_degrees=60.0,
        distortion=(-0.06, 0.01, 0.001, -0.0005, 0.02),
    )
    return write_nerfies(make(options), tmp_path_factory.mktemp("nerfies"))


@pytest.fixture(scope="session")
def colmap_capture(tmp_path_factory: pytest.TempPathFactory) -> Capture:
    """A COLMAP text model with true poses, 8 times of one moving camera, 80x64."""
    options = Options(backdrop="room", rig="path", times=8, width=80, height=64, samples=3, fov_degrees=60.0, seed=2)
    return write_colmap(make(options), tmp_path_factory.mktemp("colmap"))


@pytest.fixture(scope="session")
def images_capture(tmp_path_factory: pytest.TempPathFactory) -> Capture:
    """A bare folder: 10 images of one moving camera, 96x80."""
    options = Options(backdrop="room", rig="path", times=10, width=96, height=80, samples=3, fov_degrees=60.0)
    return write_images(make(options), tmp_path_factory.mktemp("images"))


@pytest.fixture(scope="session")
def video_capture(tmp_path_factory: pytest.TempPathFactory) -> Capture:
    """An H.264 file of 12 frames of one moving camera, 96x80; `.root` is the file."""
    options = Options(backdrop="room", rig="path", times=12, width=96, height=80, samples=3, fov_degrees=60.0)
    return write_video(make(options), tmp_path_factory.mktemp("video") / "clip.mp4")


@pytest.fixture(scope="session")
def videos_capture(tmp_path_factory: pytest.TempPathFactory) -> Capture:
    """Five videos of one event without poses, `a.mp4` to `e.mp4`: fixed cameras x 6 times, 240x180."""
    options = Options(backdrop="room", rig="arc", cameras=5, times=6, width=240, height=180, samples=2, fov_degrees=60.0)
    return write_videos(make(options), tmp_path_factory.mktemp("videos"))
