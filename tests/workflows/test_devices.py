"""Which device is taken, and the reason where it is not CUDA; found without importing torch."""

import ctypes
import types

import pytest
from e4dgs.pipeline import SettingsError
from e4dgs.workflows.machine import devices
from e4dgs.workflows.machine.devices import resolve_device, why_not_cuda


@pytest.fixture
def machine(monkeypatch, tmp_path):
    """Everything is installed, torch is built for CUDA, the driver has one device."""
    (tmp_path / "torch").mkdir()
    version = tmp_path / "torch" / "version.py"
    version.write_text("__version__ = '2.13.0+cu130'\ncuda: Optional[str] = '13.0'\n")
    present = {"torch", "cuda.bindings.nvrtc", "nvidia.cu13"}

    def find_spec(name):
        if name == "cuda.bindings.nvrtc" and "cuda" not in {found.split(".")[0] for found in present}:
            raise ModuleNotFoundError("No module named 'cuda'")  # as the real one does
        return types.SimpleNamespace(origin=str(tmp_path / "torch" / "__init__.py")) if name in present else None

    def count(pointer):
        pointer._obj.value = machine.devices
        return 0

    machine = types.SimpleNamespace(present=present, version=version, devices=1, cuInit=lambda flags: 0, cuDeviceGetCount=count)
    monkeypatch.setattr(devices, "find_spec", find_spec)
    monkeypatch.setattr(devices, "TOOLKITS", ())
    monkeypatch.setattr(devices, "SYSTEM_TOOLKIT", str(tmp_path / "none"))
    monkeypatch.setattr(ctypes, "CDLL", lambda name: machine)
    monkeypatch.setattr(ctypes.util, "find_library", lambda name: None)
    return machine


def test_a_machine_with_all_can_use_cuda(machine):
    assert why_not_cuda() is None


def test_auto_takes_cuda_where_it_can_be_used(machine, monkeypatch):
    monkeypatch.setattr(devices, "why_not_trusted", lambda: None)
    assert resolve_device("auto") == resolve_device("cuda") == "cuda" and resolve_device("cpu") == "cpu"
    machine.devices = 0
    assert resolve_device("auto") == "cpu"
    with pytest.raises(SettingsError, match="--device cuda: the NVIDIA driver finds no device"):
        resolve_device("cuda")


def test_kernels_are_trusted_once_they_agree_with_the_cpu_s(machine, monkeypatch, tmp_path):
    """A wrong answer is asked for again each time; a right one is remembered until kernels, torch or driver change."""
    answers, asked = [(1, "the gradient of gaussians.means is off by 2e-1"), (0, "fine"), (0, "fine")], []

    def run(command, **_):
        asked.append(command)
        code, said = answers[len(asked) - 1]
        return types.SimpleNamespace(returncode=code, stdout=said + "\n", stderr="")

    monkeypatch.setenv("E4DGS_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(devices.subprocess, "run", run)
    machine.cuDriverGetVersion = lambda pointer: setattr(pointer._obj, "value", machine.driver)
    machine.driver = 13000
    with pytest.raises(SettingsError, match=r"a small training step on the GPU went wrong: the gradient of gaussians\.means is off"):
        resolve_device("cuda")
    assert resolve_device("auto") == "cuda" and resolve_device("auto") == "cuda" and len(asked) == 2
    assert asked[0][1:] == ["-m", "e4dgs.scene.selftest"]
    machine.driver = 13010
    assert resolve_device("auto") == "cuda" and len(asked) == 3


def test_an_edit_of_any_kernel_asks_again(machine, monkeypatch, tmp_path):
    """All that is compiled for a GPU, whichever folder it is in, and the Python code that launches it."""
    machine.cuDriverGetVersion = lambda pointer: 0
    package = devices.PACKAGE
    sources = [
        path for kind in ("*.cu", "*.cuh") for folder in ("rasterizer", "scene", "vision") for path in (package / folder).rglob(kind)
    ]
    sources += [*(package / "rasterizer" / "math").glob("*.h"), *(package / "scene" / "cuda").glob("*.py")]
    sources += (package / "rasterizer" / "cuda" / "runtime").glob("*.py")
    copied = []
    for path in sources:
        copied.append(tmp_path / path.relative_to(package))
        copied[-1].parent.mkdir(parents=True, exist_ok=True)
        copied[-1].write_bytes(path.read_bytes())
    monkeypatch.setattr(devices, "PACKAGE", tmp_path)
    proofs = {devices._proof()}
    for path in copied:
        path.write_bytes(path.read_bytes() + b"\n")
        proofs.add(devices._proof())
    assert len(copied) > 25 and len(proofs) == len(copied) + 1


def test_the_agreement_lies_where_all_caches_do(machine, monkeypatch, tmp_path):
    machine.cuDriverGetVersion = lambda pointer: 0
    for name in ("E4DGS_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    assert devices._proof().parent == tmp_path / ".cache" / "e4dgs"
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    assert devices._proof().parent == tmp_path / ".cache" / "e4dgs", "a relative one is to be ignored"
    monkeypatch.setenv("E4DGS_CACHE", "~/mine")
    assert devices._proof().parent == tmp_path / "mine"


def test_without_a_home_folder_kernels_are_checked_each_time(machine, monkeypatch):
    def no_home() -> None:
        raise RuntimeError("Could not determine home directory.")

    for name in ("E4DGS_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    asked = []
    monkeypatch.setattr(devices.Path, "home", no_home)
    monkeypatch.setattr(devices.subprocess, "run", lambda command, **_: asked.append(command) or types.SimpleNamespace(returncode=0))
    machine.cuDriverGetVersion = lambda pointer: 0
    assert resolve_device("cuda") == resolve_device("auto") == "cuda" and len(asked) == 2


def test_a_selftest_that_does_not_end_is_no_proof(machine, monkeypatch, tmp_path):
    def run(command, timeout, **_):
        raise devices.subprocess.TimeoutExpired(command, timeout)

    monkeypatch.setenv("E4DGS_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(devices.subprocess, "run", run)
    machine.cuDriverGetVersion = lambda pointer: 0
    assert resolve_device("auto") == "cpu"


@pytest.mark.parametrize(
    ("absent", "reason"),
    [
        ({"torch"}, "torch is not installed"),
        ({"cuda.bindings.nvrtc"}, "cuda-bindings is not installed; install e4dgs[cuda13], or e4dgs[cuda12] where"),
        ({"nvidia.cu13"}, "NVRTC, which compiles the kernels, was not found; install e4dgs[cuda13]"),
    ],
)
def test_what_is_missing_is_named(machine, absent, reason):
    machine.present -= absent
    assert why_not_cuda().startswith(reason) and "\n" not in why_not_cuda()


@pytest.mark.parametrize("line", ["cuda: Optional[str] = None", "cuda = None"])
def test_a_torch_without_cuda_is_named_first(machine, line):
    machine.version.write_text(line + "\nhip = None\n")
    machine.present -= {"cuda.bindings.nvrtc"}
    assert why_not_cuda() == "the installed torch was built without CUDA"


def test_a_missing_driver_is_named(machine, monkeypatch):
    def absent(name):
        raise OSError("cannot open shared object file")

    monkeypatch.setattr(ctypes, "CDLL", absent)
    assert why_not_cuda() == "no NVIDIA driver was found (libcuda.so.1)"
    monkeypatch.setattr(ctypes, "CDLL", lambda name: types.SimpleNamespace(cuInit=lambda flags: 100))
    assert why_not_cuda() == "the NVIDIA driver finds no device"


def test_nvrtc_of_a_toolkit_counts(machine, monkeypatch, tmp_path):
    machine.present -= {"nvidia.cu13"}
    (tmp_path / "toolkit" / "lib64").mkdir(parents=True)
    (tmp_path / "toolkit" / "lib64" / "libnvrtc.so.13").write_text("")
    monkeypatch.setattr(devices, "TOOLKITS", ("CUDA_HOME",))
    monkeypatch.setenv("CUDA_HOME", str(tmp_path / "toolkit"))
    assert why_not_cuda() is None
    monkeypatch.delenv("CUDA_HOME")
    assert why_not_cuda() is not None
    monkeypatch.setattr(ctypes.util, "find_library", lambda name: "libnvrtc.so.13" if name == "nvrtc" else None)
    assert why_not_cuda() is None
