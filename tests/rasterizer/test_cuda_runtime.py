"""The CUDA kernels' way from source to code: digests, compilation, the cache on disk. No GPU is needed; NVRTC where a test compiles."""

import os
import sys
import warnings
from concurrent.futures import ThreadPoolExecutor

import pytest
from e4dgs.rasterizer.cuda.runtime import Program, cache, compiler
from e4dgs.rasterizer.cuda.runtime.compiler import Compiled, Resources, compile_cubin, resources_in
from e4dgs.rasterizer.cuda.runtime.program import _headers
from e4dgs.rasterizer.cuda.runtime.program import digest as digest_once

SOURCE = '#include "own.cuh"\nextern "C" __global__ void fill(float* out) { out[threadIdx.x] = OWN + TIMES; }\n'


def digest(program):
    """As a process sees it that starts now."""
    _headers.cache_clear()
    return digest_once.__wrapped__(program)


@pytest.fixture
def nvrtc():
    try:
        compiler.load_nvrtc()
    except RuntimeError as reason:
        pytest.skip(str(reason))


@pytest.fixture
def program(tmp_path):
    """A kernel with a header beside it and a folder of headers; spaces in the path, as users have them."""
    folder = tmp_path / "my kernels"
    (folder / "headers").mkdir(parents=True)
    (folder / "fill.cu").write_text(SOURCE)
    (folder / "own.cuh").write_text("#define OWN 2\n")
    (folder / "headers" / "other.h").write_text("")
    return Program(folder / "fill.cu", (("TIMES", 3),), (folder / "headers",))


@pytest.fixture
def kernels(tmp_path, monkeypatch):
    """The cache as a new process finds it: its folder, and what has been compiled since (through a compiler that only notes)."""
    compiled = []

    def note(program, arch):
        compiled.append(arch)
        return Compiled(b"code of " + arch.encode(), "cubin", {"fill": Resources(8, 0, 16, 1024)})

    monkeypatch.setenv("E4DGS_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(cache, "_MEMORY", {})
    monkeypatch.setattr(cache, "_WARNED", [])
    monkeypatch.setattr(cache, "compile_cubin", note)
    monkeypatch.setattr(cache, "nvrtc_version", lambda: (13, 0))
    return tmp_path / "cache", compiled


def test_the_digest_follows_from_source_headers_and_defines(program, tmp_path):
    folder = program.source.parent
    seen = {digest(program)}
    for path in (program.source, folder / "own.cuh", folder / "headers" / "other.h"):
        path.write_text(path.read_text() + "\n// changed")
        seen.add(digest(program))
    (folder / "headers" / "new.h").write_text("")
    seen.add(digest(program))
    seen.add(digest(Program(program.source, (("TIMES", 4),), program.includes)))
    assert len(seen) == 6


def test_the_digest_does_not_follow_from_place_order_or_other_files(program, tmp_path):
    two = Program(program.source, (("A", 1), ("B", 2)), program.includes)
    assert digest(two) == digest(Program(two.source, two.defines[::-1], two.includes))
    before = digest(program)
    (program.source.parent / "notes.txt").write_text("a")
    moved = program.source.parent.rename(tmp_path / "elsewhere")
    assert digest(Program(moved / "fill.cu", program.defines, (moved / "headers",))) == before


def test_a_kernel_is_compiled_once_a_process_and_once_a_machine(program, kernels):
    folder, compiled = kernels
    first = cache.compiled(program, "sm_90")
    assert cache.compiled(program, "sm_90") is first and compiled == ["sm_90"]
    cache._MEMORY.clear()  # the next process
    assert cache.compiled(program, "sm_90") == first and compiled == ["sm_90"]
    assert cache.compiled(program, "sm_80") != first and compiled == ["sm_90", "sm_80"]
    files, size = cache.usage()
    assert files == 2 and size == sum(path.stat().st_size for path in folder.iterdir())


def test_another_nvrtc_compiles_anew(program, kernels, monkeypatch):
    cache.compiled(program, "sm_90")
    cache._MEMORY.clear()
    monkeypatch.setattr(cache, "nvrtc_version", lambda: (13, 1))
    cache.compiled(program, "sm_90")
    assert kernels[1] == ["sm_90", "sm_90"]


def test_threads_that_want_the_same_compile_it_once(program, kernels):
    with ThreadPoolExecutor(4) as pool:
        assert len({id(code) for code in pool.map(lambda _: cache.compiled(program, "sm_90"), range(16))}) == 1
    assert kernels[1] == ["sm_90"]


@pytest.mark.parametrize(
    "damage", [lambda data: data[:-3], lambda data: data[:60] + b"?" + data[61:], lambda data: b"", lambda data: b"x" * 40]
)
def test_a_damaged_file_is_compiled_again(program, kernels, damage):
    folder, compiled = kernels
    good = cache.compiled(program, "sm_90")
    (path,) = folder.iterdir()
    whole = path.read_bytes()
    path.write_bytes(damage(whole))
    cache._MEMORY.clear()
    assert cache.compiled(program, "sm_90") == good and len(compiled) == 2
    assert path.read_bytes() == whole and [*folder.iterdir()] == [path]


def test_without_a_folder_it_warns_once_and_goes_on(program, kernels, monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("E4DGS_CACHE", str(tmp_path / "file" / "below"))  # holds for root too, whom no permission stops
    with pytest.warns(UserWarning, match="set E4DGS_CACHE to a folder that can be written"):
        assert cache.compiled(program, "sm_90").code == b"code of sm_90"
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        cache.compiled(program, "sm_80")
    assert cache.compiled(program, "sm_90").code == b"code of sm_90" and kernels[1] == ["sm_90", "sm_80"]
    assert cache.usage() == (0, 0)


def test_the_least_recently_used_go_first(program, kernels, monkeypatch):
    folder, compiled = kernels
    for arch in ("sm_75", "sm_80", "sm_86"):
        cache.compiled(program, arch)
    size = cache.usage()[1] // 3
    for age, path in enumerate(sorted(folder.iterdir(), key=lambda path: path.read_bytes()[-5:])):
        os.utime(path, (0, 1e9 + age))
    cache._MEMORY.clear()
    cache.compiled(program, "sm_75")  # used now, so sm_80 is the oldest
    monkeypatch.setattr(cache, "LIMIT", 3 * size)
    cache.compiled(program, "sm_89")
    kept = {path.read_bytes()[-5:].decode() for path in folder.iterdir()}
    assert kept == {"sm_75", "sm_86", "sm_89"} and compiled == ["sm_75", "sm_80", "sm_86", "sm_89"]


def test_the_folder_is_the_users_cache(monkeypatch, tmp_path):
    monkeypatch.delenv("E4DGS_CACHE", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache.folder() == tmp_path / "e4dgs" / "kernels"
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")  # to be ignored, says the XDG specification
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert cache.folder() == tmp_path / "home" / ".cache" / "e4dgs" / "kernels"


def test_a_program_compiles_with_its_headers_and_defines(program, nvrtc):
    compiled = compile_cubin(program, "sm_80")
    assert compiled.form == "cubin" and compiled.code.startswith(b"\x7fELF") and list(compiled.resources) == ["fill"]
    assert 0 < compiled.resources["fill"].registers < 32
    other = Program(program.source, (("TIMES", 4),), program.includes)
    assert compile_cubin(other, "sm_80").code != compiled.code


def test_what_ptxas_says_is_read(tmp_path, nvrtc):
    path = tmp_path / "two.cu"
    path.write_text(
        'extern "C" __global__ void stack(float* a, int n) {\n'
        "    float b[32] = {};\n    for (int i = 0; i < n; ++i) b[int(a[i]) & 31] += a[i];\n    a[n] = b[n & 31];\n}\n"
        'extern "C" __global__ void shared(float* a) { __shared__ float s[512]; s[threadIdx.x] = a[0]; __syncthreads(); a[0] = s[5]; }\n'
    )
    found = compile_cubin(Program(path, includes=()), "sm_90").resources
    assert found["stack"].stack_bytes >= 128 and found["stack"].shared_bytes == 0
    assert found["shared"].shared_bytes == 2048 and found["shared"].stack_bytes == 0
    assert found["stack"].spill_bytes == found["shared"].spill_bytes == 0


def test_spills_are_read_also_of_functions_that_were_not_inlined():
    log = """ptxas info    : Compiling entry function 'k' for 'sm_90'
ptxas info    : Function properties for k
ptxas         .     432 bytes stack frame, 504 bytes spill stores, 500 bytes spill loads
ptxas info    : Used 32 registers, used 1 barriers, 448 bytes cumulative stack size, 16 bytes smem, 360 bytes cmem[0]
ptxas info    : Function properties for _Z1gf
    8 bytes stack frame, 4 bytes spill stores, 4 bytes spill loads
"""
    assert resources_in(log) == {"k": Resources(registers=32, spill_bytes=1012, stack_bytes=448, shared_bytes=16)}


def test_an_error_shows_the_first_lines_and_what_to_do(program, nvrtc):
    program.source.write_text(SOURCE + "int broken = nobody;\n")
    with pytest.raises(RuntimeError, match=r"fill.cu TIMES=3 does not compile for sm_90 \(NVRTC 1") as error:
        compile_cubin(program, "sm_90")
    assert f'{program.source}(3): error: identifier "nobody" is undefined' in str(error.value)
    assert "correct it, or, if you did not change it, install e4dgs again" in str(error.value)


def test_an_unknown_newer_architecture_gets_ptx(program, nvrtc, monkeypatch):
    monkeypatch.setattr(compiler, "architectures", lambda: (75, 80, 90))
    assert compiler.target_of("sm_86") == "compute_80" and compiler.target_of("sm_90") == "sm_90"
    compiled = compile_cubin(program, "sm_120")
    assert compiled.form == "ptx" and b".target sm_90" in compiled.code and compiled.code.endswith(b"\0")
    with pytest.raises(RuntimeError, match="sm_75 and newer, and this device is sm_70"):
        compile_cubin(program, "sm_70")
    with pytest.raises(ValueError, match=r"e.g. sm_90, got '9.0'"):
        compile_cubin(program, "9.0")


def test_without_nvrtc_the_cache_passes_on_what_to_install(program, kernels, monkeypatch):
    def missing():
        raise RuntimeError("NVRTC was not found")

    monkeypatch.setattr(cache, "nvrtc_version", missing)
    with pytest.raises(RuntimeError, match="NVRTC was not found"), warnings.catch_warnings():
        warnings.simplefilter("error")
        cache.compiled(program, "sm_90")


def test_without_nvrtc_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "cuda.bindings", None)
    with pytest.raises(RuntimeError, match=r"pip install 'e4dgs\[cuda13\]', or 'e4dgs\[cuda12\]'"):
        compiler.load_nvrtc.__wrapped__()
