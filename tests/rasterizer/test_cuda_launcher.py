"""Launches, against a stand-in for the driver that notes what it is given: without a GPU, what reaches the driver's door can be held.

Tensors of the CPU are passed off as the device's; streams, devices and contexts are numbers.
"""

import ctypes
import sys
import threading
import types
from contextlib import contextmanager
from pathlib import Path

import pytest
import torch
from e4dgs.rasterizer.cuda.runtime import Program, available, cache, cuda_launcher, launcher, launcher_for, launching, warm_up
from e4dgs.rasterizer.cuda.runtime.compiler import Compiled, Resources
from e4dgs.rasterizer.cuda.runtime.cuda_launcher import CudaLauncher

PROGRAM = Program(Path("blend.cu"), (("POINTS", 6),))


class OnDevice(torch.Tensor):
    """A tensor that says it is on CUDA device 1."""

    is_cuda = True
    device = torch.device("cuda", 1)

    def get_device(self):
        return 1


def on_device(*shape: int) -> OnDevice:
    return torch.zeros(*shape).as_subclass(OnDevice)


class Driver:
    """What the stand-in is told, and the current device and stream of the thread. It takes the place of `cuda.bindings.driver`."""

    def __init__(self) -> None:
        self.launches: list[tuple] = []
        self.loaded: list[bytes] = []
        self.contexts: list[tuple[str, str]] = []
        self.kernels: list[tuple[bytes, str]] = []  # an address counts from 1
        self.device, self.stream, self.capturing, self.status = 1, 0, False, 0

    CUresult = int

    def cuInit(self, flags):
        return (0,)

    def cuDevicePrimaryCtxRetain(self, index):
        return 0, f"context {index}"

    def cuCtxSetCurrent(self, context):
        self.contexts.append((threading.current_thread().name, context))
        return (0,)

    def cuLibraryLoadData(self, code, *options):
        self.loaded.append(code)
        return (200, None) if b"broken" in code else (0, code)

    def cuLibraryGetKernel(self, library, name):
        if name == b"absent":
            return 500, None
        self.kernels.append((library, name.decode()))
        return 0, len(self.kernels)

    def cuGetErrorName(self, error):
        return 0, {200: b"CUDA_ERROR_INVALID_IMAGE", 500: b"CUDA_ERROR_NOT_FOUND", 700: b"CUDA_ERROR_ILLEGAL_ADDRESS"}[error]

    def cuGetErrorString(self, error):
        return 0, b"in words"

    def launch(self, address, blocks, threads, stream, device, arguments):
        """As `_cpu.launch`."""
        if any(self.is_wrong(argument, device) for argument in arguments):
            return -1
        if self.status == 0:
            self.launches.append((self.kernels[address - 1], blocks, threads, stream, device, arguments))
        return self.status

    @staticmethod
    def is_wrong(argument, device):
        if isinstance(argument, torch.Tensor):
            return argument.get_device() != device or not argument.is_contiguous()
        return argument is not None and type(argument) not in cuda_launcher.SCALARS


@pytest.fixture
def driver(monkeypatch):
    driver = Driver()

    @contextmanager
    def device(index):
        before, driver.device = driver.device, index
        yield
        driver.device = before

    bindings = types.ModuleType("cuda.bindings")
    bindings.driver = driver
    monkeypatch.setitem(sys.modules, "cuda.bindings", bindings)
    monkeypatch.setattr(cuda_launcher, "_cpu", types.SimpleNamespace(can_launch=lambda *types: True, launch=driver.launch))
    monkeypatch.setattr(cuda_launcher, "_current_device", lambda: driver.device)
    monkeypatch.setattr(cuda_launcher, "current_stream", lambda index: driver.stream)
    monkeypatch.setattr(torch.cuda, "get_device_capability", lambda index: (9, 0))
    monkeypatch.setattr(torch.cuda, "device", device)
    monkeypatch.setattr(torch.cuda, "is_current_stream_capturing", lambda: driver.capturing)
    monkeypatch.setattr(torch.cuda, "current_device", lambda: driver.device)
    monkeypatch.setattr(cuda_launcher, "_LIBRARIES", {})
    monkeypatch.setattr(cuda_launcher, "_THREAD", cuda_launcher._Thread())
    used = {"forward": Resources(32, 0, 0, 0)}
    monkeypatch.setattr(cache, "compiled", lambda program, arch: Compiled(f"{program} {arch}".encode(), "cubin", used))
    return driver


@pytest.fixture
def cuda(driver):
    return CudaLauncher(torch.device("cuda", 1))


def test_a_launch_gives_stream_shape_and_arguments_in_order(driver, cuda):
    driver.stream = 12345
    arguments = on_device(3), None, ctypes.c_int32(7), on_device(2, 2), ctypes.c_float(0.5)
    cuda.launch(PROGRAM, "forward", 40, 128, *arguments)
    assert driver.launches == [((b"blend.cu POINTS=6 sm_90", "forward"), 40, 128, 12345, 1, arguments)]


def test_a_program_is_loaded_once_for_all_its_kernels_and_launches(driver, cuda):
    for kernel in ("forward", "backward", "forward"):
        cuda.launch(PROGRAM, kernel, 1, 32)
    CudaLauncher(torch.device("cuda", 0)).launch(PROGRAM, "forward", 1, 32)  # another device of the same architecture
    assert driver.loaded == [b"blend.cu POINTS=6 sm_90"] and len(driver.launches) == 4
    cuda.launch(Program(PROGRAM.source, (("POINTS", 8),)), "forward", 1, 32)
    assert len(driver.loaded) == 2


def test_ptx_is_loaded_with_a_zero_at_its_end(driver, cuda, monkeypatch):
    monkeypatch.setattr(cache, "compiled", lambda program, arch: Compiled(b"text", "ptx", {}))
    cuda.launch(PROGRAM, "forward", 1, 32)
    assert driver.loaded == [b"text\0"]


def test_the_current_stream_is_asked_for_at_every_launch(driver, cuda):
    for driver.stream in (0, 5, 0):
        cuda.launch(PROGRAM, "forward", 1, 32)
    assert [launch[3] for launch in driver.launches] == [0, 5, 0]


def test_the_launchers_device_is_current_while_it_launches_and_only_then(driver, cuda):
    driver.device, launch, seen = 0, driver.launch, []
    cuda_launcher._cpu.launch = lambda *given: seen.append(driver.device) or launch(*given)
    cuda.launch(PROGRAM, "forward", 1, 32)
    assert seen == [1] and driver.device == 0 and len(driver.launches) == 1


def test_every_thread_gets_a_context_once(driver, cuda):
    def twice() -> None:
        cuda.launch(PROGRAM, "forward", 1, 32)
        cuda.launch(PROGRAM, "forward", 1, 32)

    twice()
    thread = threading.Thread(target=twice, name="autograd")
    thread.start()
    thread.join()
    assert driver.contexts == [(threading.current_thread().name, "context 1"), ("autograd", "context 1")] and len(driver.launches) == 4


def test_no_blocks_no_launch_and_too_many_are_refused(driver, cuda):
    cuda.launch(PROGRAM, "forward", 0, 128)
    assert driver.launches == driver.loaded == []
    for blocks in (2**31, -1):
        with pytest.raises(ValueError, match=f"forward wants {blocks} blocks, and a grid has at most 2147483647"):
            cuda.launch(PROGRAM, "forward", blocks, 128)
    cuda.launch(PROGRAM, "forward", 2**31 - 1, 128)


@pytest.mark.parametrize(
    ("argument", "error", "message"),
    [
        (torch.zeros(3), ValueError, "argument 1 of kernel forward is on cpu, and the kernel runs on cuda:1"),
        (on_device(3, 2).T, ValueError, "argument 1 of kernel forward is not contiguous"),
        (3, TypeError, "ctypes scalar of fixed width such as ctypes.c_int32, got int"),
        (True, TypeError, "got bool"),
        (0.5, TypeError, "got float"),
        (ctypes.c_void_p(3), TypeError, "got c_void_p"),
    ],
)
def test_arguments_are_checked(driver, cuda, argument, error, message):
    with pytest.raises(error, match=message):
        cuda.launch(PROGRAM, "forward", 1, 32, None, argument)
    assert driver.launches == []


def test_errors_name_kernel_program_and_shape(driver, cuda, monkeypatch):
    driver.status = 700
    with pytest.raises(
        RuntimeError, match=r"forward of blend.cu POINTS=6 .* cuda:1 \(grid 3, block 64\): CUDA_ERROR_ILLEGAL.*in words.*LAUNCH_BLOCKING=1"
    ):
        cuda.launch(PROGRAM, "forward", 3, 64)
    driver.status = 12345  # which the bindings do not know
    with pytest.raises(RuntimeError, match="error 12345"):
        cuda.launch(PROGRAM, "forward", 3, 64)
    with pytest.raises(RuntimeError, match=r"could not load kernel absent of blend.cu POINTS=6 .*; the program has forward: .*NOT_FOUND"):
        cuda.launch(PROGRAM, "absent", 3, 64)
    monkeypatch.setattr(cache, "compiled", lambda program, arch: Compiled(b"broken", "cubin", {}))
    with pytest.raises(RuntimeError, match=r"could not load kernel forward of tiles.cu on cuda:1.*INVALID_IMAGE"):
        cuda.launch(Program(Path("tiles.cu")), "forward", 3, 64)
    assert all(program.source.name != "tiles.cu" for program, _ in cuda_launcher._LIBRARIES), "the next launch tries again"


def test_nothing_is_loaded_inside_a_graph_capture(driver, cuda):
    cuda.launch(PROGRAM, "forward", 1, 32)
    driver.capturing = True
    cuda.launch(PROGRAM, "forward", 2, 32)
    with pytest.raises(RuntimeError, match=r"backward of blend.cu POINTS=6 is used for the first time inside a CUDA graph capture"):
        cuda.launch(PROGRAM, "backward", 1, 32)


def test_the_real_bindings_have_what_is_called():
    driver = pytest.importorskip("cuda.bindings.driver")
    used = (
        "cuInit",
        "cuDevicePrimaryCtxRetain",
        "cuCtxSetCurrent",
        "cuLibraryLoadData",
        "cuLibraryGetKernel",
        "cuGetErrorName",
        "cuGetErrorString",
    )
    assert all(callable(getattr(driver, name)) for name in used)
    assert int(driver.CUresult(0)) == 0 and int(driver.CUkernel(12)) == 12


def test_a_registered_launcher_stands_in_for_its_device():
    cpu, one, two = torch.device("cpu"), object(), object()
    with launching("cpu", one):
        assert launcher_for(cpu) is one
        with launching(cpu, two):
            assert launcher_for(cpu) is two
        assert launcher_for(cpu) is one
        warm_up([PROGRAM], cpu)  # nothing to prepare
    with pytest.raises(
        ValueError, match=r"backend 'cuda' wants tensors on a CUDA device, got cpu; move them with .cuda\(\) or use backend='cpu'"
    ):
        launcher_for(cpu)


def test_launcher_for_a_device_is_one_object_or_the_reason(driver, monkeypatch):
    monkeypatch.setattr(launcher, "_CUDA", {})
    monkeypatch.setattr(available, "why_not", lambda index: "no driver")
    with pytest.raises(RuntimeError, match="backend 'cuda' cannot be used: no driver"):
        launcher_for(torch.device("cuda", 0))
    monkeypatch.setattr(available, "why_not", lambda index: None)
    first = launcher_for(torch.device("cuda"))
    assert first is launcher_for(torch.device("cuda", 1)) and first is not launcher_for(torch.device("cuda", 0))


def test_warming_up_compiles_and_loads_nothing(driver, monkeypatch):
    compiled = []
    monkeypatch.setattr(launcher, "_CUDA", {})
    monkeypatch.setattr(available, "why_not", lambda index: None)
    monkeypatch.setattr(cache, "compiled", lambda program, arch: compiled.append((str(program), arch)))
    warm_up([PROGRAM, Program(Path("tiles.cu"))], torch.device("cuda", 1))
    assert sorted(compiled) == [("blend.cu POINTS=6", "sm_90"), ("tiles.cu", "sm_90")] and driver.loaded == []
