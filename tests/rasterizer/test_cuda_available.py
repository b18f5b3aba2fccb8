"""Every reason why the CUDA kernels cannot be used is one line that says what to do; the doctor's rows never raise."""

import subprocess
import sys
import types
from pathlib import Path

import pytest
import torch
from e4dgs.rasterizer.cuda.runtime import available, compiler
from e4dgs.rasterizer.cuda.runtime.available import describe, why_not


@pytest.fixture
def machine(monkeypatch):
    """A machine on which all is well: an H100, a driver for CUDA 13.1, NVRTC 13.0. Tests take a part away."""
    monkeypatch.setattr(torch.version, "cuda", "13.0")
    monkeypatch.setattr(available, "load_nvrtc", lambda: None)
    monkeypatch.setattr(available, "nvrtc_version", lambda: (13, 0))
    monkeypatch.setattr(compiler, "nvrtc_version", lambda: (13, 0))
    monkeypatch.setattr(compiler, "architectures", lambda: (75, 80, 86, 89, 90, 120))
    monkeypatch.setattr(available, "driver_version", lambda: (13, 1))
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 1)
    monkeypatch.setattr(torch.cuda, "get_device_capability", lambda index: (9, 0))
    monkeypatch.setattr(torch.cuda, "get_device_name", lambda index: "some GPU")
    return monkeypatch


def test_nothing_speaks_against_a_machine_that_has_all(machine):
    assert why_not() is None and why_not(0) is None


def missing(*_):
    raise RuntimeError("NVRTC was not found (no file); install what compiles the kernels\nmore")


@pytest.mark.parametrize(
    ("owner", "name", "value", "reason"),
    [
        (torch.version, "cuda", None, "built without CUDA; install one with it"),
        (available, "load_nvrtc", missing, "NVRTC was not found"),
        (available, "driver_version", lambda: None, "no NVIDIA driver was found; install one"),
        (torch.cuda, "device_count", lambda: 0, "finds no device that torch can use; look at nvidia-smi"),
        (
            available,
            "driver_version",
            lambda: (12, 8),
            r"supports CUDA 12.8 .* NVRTC 13.0 compiles; update the driver, or install e4dgs\[cuda12\]",
        ),
        (
            torch.cuda,
            "get_device_capability",
            lambda index: (7, 0),
            "some GPU has compute capability 7.0, and the kernels want 7.5 or newer",
        ),
        (compiler, "architectures", lambda: (100, 120), "compiles for sm_100 and newer, and this device is sm_90"),
        (torch.cuda, "device_count", missing, "CUDA fails here: NVRTC was not found"),
    ],
)
def test_each_reason_is_one_line(machine, owner, name, value, reason):
    machine.setattr(owner, name, value)
    problem = why_not()
    assert problem is not None and "\n" not in problem
    with pytest.raises(RuntimeError, match=reason):
        raise RuntimeError(problem)


def test_a_device_that_is_not_there_is_named(machine):
    assert why_not(3) == "there is no CUDA device 3, the last one is 0"


def test_an_unknown_newer_device_wants_a_driver_as_new_as_nvrtc(machine):
    machine.setattr(torch.cuda, "get_device_capability", lambda index: (13, 0))
    assert why_not() is None
    machine.setattr(available, "driver_version", lambda: (13, 1))
    machine.setattr(available, "nvrtc_version", lambda: (13, 2))
    assert "does not know compute capability 13.0, and the driver (CUDA 13.1) is older" in why_not()


def test_importing_the_backend_imports_nothing_of_cuda():
    code = """if True:
        import sys, torch
        before = set(sys.modules)  # torch imports cuda.bindings itself where it is installed
        import e4dgs.rasterizer
        from e4dgs.rasterizer.cuda.runtime import available, cache, compiler, cuda_launcher, launcher, program
        print([name for name in set(sys.modules) - before if name.split(".")[0] == "cuda"])"""
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip() == "[]"


def test_tests_that_want_a_gpu_are_not_collected_without_one(request, monkeypatch):
    (plugin,) = (
        one for one in request.config.pluginmanager.get_plugins() if str(getattr(one, "__file__", "")).endswith("tests/conftest.py")
    )
    plain, marked = (
        types.SimpleNamespace(get_closest_marker=lambda name, mine=mine: mine, path=Path("test_any.py"))
        for mine in (None, pytest.mark.cuda)
    )
    left_out: list = []
    config = types.SimpleNamespace(hook=types.SimpleNamespace(pytest_deselected=lambda items: left_out.extend(items)))
    for reason, kept in (("no driver", [plain]), (None, [plain, marked])):
        monkeypatch.setattr(available, "why_not", lambda reason=reason: reason)
        items = [plain, marked]
        plugin.pytest_collection_modifyitems(config, items)
        assert items == kept
    assert left_out == [marked]


def test_the_doctor_describes_a_machine_with_a_device(machine, tmp_path):
    about = types.SimpleNamespace(name="some GPU", major=9, minor=0, total_memory=80 * 2**30)
    machine.setattr(torch.cuda, "get_device_properties", lambda index: about)
    machine.setenv("E4DGS_CACHE", str(tmp_path))
    (tmp_path / "a.kernel").write_bytes(bytes(2**20))
    rows = {what: (well, detail) for what, well, detail in describe()}
    assert rows["CUDA kernels"] == (True, "usable") and rows["CUDA driver"] == (True, "supports CUDA 13.1")
    assert rows["CUDA device 0"] == (True, "some GPU, compute capability 9.0, 80 GiB; compiled for sm_90")
    assert rows["CUDA kernel cache"] == (None, f"{tmp_path}: 1 files, 1.0 of at most 512 MiB")


def test_the_doctor_compiles_a_kernel_where_it_can():
    try:
        compiler.load_nvrtc()
    except RuntimeError as reason:
        pytest.skip(str(reason))
    rows = {what: (well, detail) for what, well, detail in describe()}
    assert rows["CUDA compiler (NVRTC)"][0] and "libnvrtc" in rows["CUDA compiler (NVRTC)"][1]
    assert rows["CUDA kernel compiles"][0] and "bytes of cubin" in rows["CUDA kernel compiles"][1]


def test_the_doctor_goes_on_whatever_is_broken(machine):
    for name in ("driver_version", "load_nvrtc"):
        machine.setattr(available, name, missing)
    machine.setattr(torch.cuda, "device_count", missing)
    rows = describe()
    assert [what for what, _, _ in rows] == ["CUDA kernels", "CUDA driver", "CUDA devices", "CUDA compiler (NVRTC)", "CUDA kernel cache"]
    assert all("\n" not in detail for _, _, detail in rows) and not any(well for _, well, _ in rows)
