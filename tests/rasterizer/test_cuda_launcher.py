"""Launches, against a stand-in for cuda.core that notes what it is given: without a GPU, what reaches the driver's door can be held.

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
    """What the stand-in is told, and the current device and stream of the thread."""

    def __init__(self) -> None:
        self.launches: list[tuple] = []
        self.loaded: list[tuple] = []
        self.contexts: list[tuple[str, int]] = []
        self.device, self.stream, self.capturing, self.error = 1, 0, False, ""


@pytest.fixture
def driver(monkeypatch):
    driver = Driver()

    class ObjectCode:
        def __init__(self, code, form):
            self.code = code
            driver.loaded.append((code, form))

        from_cubin = classmethod(lambda cls, code, name="": cls(code, "cubin"))
        from_ptx = classmethod(lambda cls, code, name="": cls(code, "ptx"))

        def get_kernel(self, name):
            if name == "absent":
                raise RuntimeError("CUDA_ERROR_NOT_FOUND")
            return self.code, name

    class Device:
        def __init__(self, index):
            self.index = index

        def set_current(self):
            driver.contexts.append((threading.current_thread().name, self.index))

    monkeypatch.setattr(cuda_launcher, "_cpu", types.SimpleNamespace(can_launch=lambda *types: False))

    def launch(stream, config, kernel, *arguments):
        if driver.error:
            raise ValueError(driver.error)
        driver.launches.append((stream, config, kernel, arguments, driver.device))

    @contextmanager
    def device(index):
        before, driver.device = driver.device, index
        yield
        driver.device = before

    core = types.ModuleType("cuda.core")
    core.ObjectCode, core.Device, core.launch = ObjectCode, Device, launch
    core.LaunchConfig = lambda grid, block: ("config", grid, block)
    core.Stream = types.SimpleNamespace(from_handle=lambda handle: ("stream", handle))
    monkeypatch.setitem(sys.modules, "cuda.core", core)
    monkeypatch.setattr(torch.cuda, "get_device_capability", lambda index: (9, 0))
    monkeypatch.setattr(torch.cuda, "current_device", lambda: driver.device)
    monkeypatch.setattr(torch.cuda, "device", device)
    monkeypatch.setattr(torch.cuda, "current_stream", lambda index: types.SimpleNamespace(cuda_stream=driver.stream))
    monkeypatch.setattr(torch.cuda, "is_current_stream_capturing", lambda: driver.capturing)
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
    a, b = on_device(3), on_device(2, 2)
    n, x = ctypes.c_int32(7), ctypes.c_float(0.5)
    cuda.launch(PROGRAM, "forward", 40, 128, a, None, n, b, x)
    kernel = (b"blend.cu POINTS=6 sm_90", "forward")
    assert driver.launches == [(("stream", 12345), ("config", 40, 128), kernel, (a.data_ptr(), 0, 7, b.data_ptr(), x), 1)]


def test_a_program_is_loaded_once_for_all_its_kernels_and_launches(driver, cuda):
    for kernel in ("forward", "backward", "forward"):
        cuda.launch(PROGRAM, kernel, 1, 32)
    CudaLauncher(torch.device("cuda", 0)).launch(PROGRAM, "forward", 1, 32)  # another device of the same architecture
    assert driver.loaded == [(b"blend.cu POINTS=6 sm_90", "cubin")] and len(driver.launches) == 4
    cuda.launch(Program(PROGRAM.source, (("POINTS", 8),)), "forward", 1, 32)
    assert len(driver.loaded) == 2


def test_ptx_is_loaded_as_ptx(driver, cuda, monkeypatch):
    monkeypatch.setattr(cache, "compiled", lambda program, arch: Compiled(b"text", "ptx", {}))
    cuda.launch(PROGRAM, "forward", 1, 32)
    assert driver.loaded == [(b"text", "ptx")]


def test_the_current_stream_is_asked_for_at_every_launch(driver, cuda):
    for driver.stream in (0, 5, 0):
        cuda.launch(PROGRAM, "forward", 1, 32)
    assert [launch[0] for launch in driver.launches] == [("stream", 0), ("stream", 5), ("stream", 0)]


def test_the_launchers_device_is_current_while_it_launches_and_only_then(driver, cuda):
    driver.device = 0
    cuda.launch(PROGRAM, "forward", 1, 32)
    assert driver.launches[0][4] == 1 and driver.device == 0


def test_every_thread_gets_a_context_once(driver, cuda):
    def twice() -> None:
        cuda.launch(PROGRAM, "forward", 1, 32)
        cuda.launch(PROGRAM, "forward", 1, 32)

    twice()
    thread = threading.Thread(target=twice, name="autograd")
    thread.start()
    thread.join()
    assert driver.contexts == [(threading.current_thread().name, 1), ("autograd", 1)] and len(driver.launches) == 4


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


def test_errors_name_kernel_program_and_shape(driver, cuda):
    driver.error = "CUDA_ERROR_ILLEGAL_ADDRESS"
    with pytest.raises(
        RuntimeError, match=r"forward of blend.cu POINTS=6 .* cuda:1 \(grid 3, block 64\): CUDA_ERROR_ILLEGAL.*LAUNCH_BLOCKING=1"
    ):
        cuda.launch(PROGRAM, "forward", 3, 64)
    with pytest.raises(RuntimeError, match=r"absent of blend.cu POINTS=6 could not be loaded .*NOT_FOUND; the program has forward"):
        cuda.launch(PROGRAM, "absent", 3, 64)


def test_nothing_is_loaded_inside_a_graph_capture(driver, cuda):
    cuda.launch(PROGRAM, "forward", 1, 32)
    driver.capturing = True
    cuda.launch(PROGRAM, "forward", 2, 32)
    with pytest.raises(RuntimeError, match=r"backward of blend.cu POINTS=6 is used for the first time inside a CUDA graph capture"):
        cuda.launch(PROGRAM, "backward", 1, 32)


def test_shapes_do_not_pile_up(driver, cuda, monkeypatch):
    monkeypatch.setattr(cuda_launcher, "KEPT", 5)
    for blocks in range(1, 40):
        cuda.launch(PROGRAM, "forward", blocks, 32)
    assert len(cuda._configs) <= 5 and [launch[1][1] for launch in driver.launches] == [*range(1, 40)]


def test_the_real_cuda_core_takes_what_is_passed():
    core = pytest.importorskip("cuda.core")
    assert core.LaunchConfig(grid=40, block=128).grid == (40, 1, 1) and core.LaunchConfig(grid=40, block=128).block == (128, 1, 1)
    assert core.Stream.from_handle(0).__cuda_stream__() == (0, 0)  # torch's default stream
    assert all(hasattr(core.ObjectCode, name) for name in ("from_cubin", "from_ptx", "get_kernel"))
    assert hasattr(core.Device, "set_current") and callable(core.launch)


def test_the_driver_finds_every_scalar_in_the_parameters_width(cuda):
    """cuda-core's own list of parameters, read as the driver does: so many bytes at each address as the kernel's parameter has."""
    pytest.importorskip("cuda.core._kernel_arg_handler")
    from cuda.core._kernel_arg_handler import ParamHolder

    whole = {kind: (1,) if kind is ctypes.c_bool else (-1, 0, 1, -(2**62), 2**62 + 3) for kind in cuda_launcher.SCALARS}
    given = [kind(value) for kind, values in whole.items() for value in values] + [ctypes.c_uint64(2**64 - 1), ctypes.c_float(0.1)]
    tensor = on_device(3)
    values = cuda._values("forward", (None, tensor, *given))
    holder = ParamHolder(tuple(values))
    addresses = ctypes.cast(holder.ptr, ctypes.POINTER(ctypes.c_void_p))
    for place, want in enumerate([ctypes.c_int64(0), ctypes.c_int64(tensor.data_ptr()), *given]):
        assert ctypes.cast(addresses[place], ctypes.POINTER(type(want)))[0] == want.value


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
