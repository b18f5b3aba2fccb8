"""What may be launched with what, and when it is compiled."""

import re
from ctypes import c_bool, c_double, c_float, c_int32, c_int64, c_uint32, c_uint64
from pathlib import Path

import pytest
import torch

from simt import SimtError, compile, needs_compiler, why_not
from simt.own_kernels import Program, kernels_of, launch

pytestmark = needs_compiler


def arguments(**changed: object) -> list[object]:
    right = {
        "n": c_int32(-1),
        "u": c_uint32(2**32 - 1),
        "l": c_int64(-(2**40)),
        "v": c_uint64(2**50),
        "f": c_float(0.5),
        "d": c_double(1e-3),
    }
    right |= {"flag": c_bool(True), "x": torch.full((2,), 7.0), "records": torch.arange(4.0), "out": torch.zeros(10, dtype=torch.float64)}
    return list((right | changed).values())


def test_arguments_arrive():
    given = arguments()
    launch(kernels_of("parameters", BIAS=4), "take", 1, 32, *given)
    assert given[-1].tolist() == [-1, 2**32 - 1, -(2**40), 2**50, 0.5, 1e-3, 1, 7, 3, 4]
    given = arguments(x=None)
    launch(kernels_of("parameters", BIAS=6), "take", 1, 32, *given)
    assert given[-1][7:].tolist() == [-1, 3, 6]


WRONG = {
    r"n is a scalar \(integer, 4 bytes\), and was given a c_long": {"n": c_int64(3)},
    r"n is a scalar .* was given a int$": {"n": 3},
    r"f is a scalar \(floating, 4 bytes\), and was given a c_int": {"f": c_int32(3)},
    r"d is a scalar .* was given a torch.float64 tensor \[1\]": {"d": torch.ones(1, dtype=torch.float64)},
    r"x is a pointer, and was given a c_": {"x": c_int64(3)},
    r"x points to floating of 4 bytes, and was given a torch.float64 tensor": {"x": torch.ones(2, dtype=torch.float64)},
    r"x must be a contiguous tensor on the CPU, .* with strides \[1, 2\]": {"x": torch.ones(2, 2).T},
    r"records must be a contiguous tensor on the CPU, .* on meta": {"records": torch.ones(2, device="meta")},
}


@pytest.mark.parametrize("message", WRONG)
def test_arguments_of_a_wrong_type_are_refused(message):
    with pytest.raises(SimtError, match=f"parameters.cu: take: {message}"):
        launch(kernels_of("parameters", BIAS=4), "take", 1, 32, *arguments(**WRONG[message]))


def test_launches_that_cannot_be_are_refused():
    program = kernels_of("parameters", BIAS=4)
    with pytest.raises(SimtError, match=r"take: takes 10 arguments \(n, u, l, v, f, d, flag, x, records, out\), not 9"):
        launch(program, "take", 1, 32, *arguments()[:-1])
    with pytest.raises(SimtError, match="there is no such kernel, only take"):
        launch(program, "only_with_a_bias", 1, 32)
    for threads in (0, 65):
        with pytest.raises(SimtError, match=f"a block of this kernel has 1 to 64 threads, not {threads}"):
            launch(program, "take", 1, threads, *arguments())
    with pytest.raises(SimtError, match="blocks, not -1"):
        launch(program, "take", -1, 32, *arguments())
    given = arguments()
    launch(program, "take", 0, 32, *given)
    assert given[-1].tolist() == [0] * 10
    launch(kernels_of("parameters", BIAS=6), "only_with_a_bias", 1, 1024)


STAND_IN = """#!/bin/sh
case "$*" in *--version*) exit ;; esac
echo "$*" >> "$(dirname "$0")/calls"
for last; do :; done
echo 'extern "C" __attribute__((simt_kernel)) void k() {}' > "$last"
"""


def test_a_library_is_made_once_for_what_goes_into_it(tmp_path, monkeypatch):
    compiler, header = tmp_path / "compiler", tmp_path / "headers" / "b.cuh"
    compiler.write_text(STAND_IN)
    compiler.chmod(0o755)
    monkeypatch.setenv("CXX", str(compiler))
    monkeypatch.setenv("E4DGS_SIMT_DIR", str(tmp_path / "made"))
    header.parent.mkdir()
    (tmp_path / "a.cu").write_text('#include "b.cuh"')

    def calls(program: Program, flags: tuple[str, ...] = ()) -> tuple[Path, int]:
        (tmp_path / "calls").write_text("")
        made = compile(program, flags)
        assert made.is_file() and made.parent == tmp_path / "made" and not [path for path in made.parent.iterdir() if path.is_dir()]
        return made, len((tmp_path / "calls").read_text().splitlines())

    program = Program(tmp_path / "a.cu", (), (tmp_path / "headers",))
    header.write_text("// one")
    first = calls(program)
    assert first[1] == 4 and calls(program) == (first[0], 0)  # the run time, then three steps; nothing
    assert calls(Program(tmp_path / "a.cu", (("X", 1),), program.includes))[1] == 3
    assert calls(program, ("-DY",))[1] == 4
    header.write_text("// two")
    (tmp_path / "headers" / "unused.cuh").write_text("")
    second = calls(program)
    assert second[1] == 3 and second[0] != first[0]
    (tmp_path / "headers" / "unused.cuh").write_text("// changed")
    assert calls(program) == (second[0], 0)


BAD = """
struct Three { int x[3]; };
extern "C" __global__ void k(int* out) { out[0] = nothing_known; }
extern "C" __global__ void l(unsigned* out) { out[0] = __activemask(); }
extern "C" __global__ void m(long long* out) { out[0] = min(1ll, 2); }  // ambiguous in CUDA too
extern "C" __global__ void n(Three three) {}
"""


def test_what_does_not_compile_says_why(tmp_path):
    (tmp_path / "bad.cu").write_text(BAD)
    with pytest.raises(SimtError) as caught:
        compile(Program(tmp_path / "bad.cu"))
    assert re.search(r"bad.cu:4:.*deleted function .*__activemask", str(caught.value))
    for said in (r"bad.cu:3:.*nothing_known", r"bad.cu:5:.*call of overloaded .*min", r"kernels take pointers and scalars"):
        assert re.search(said, str(caught.value)), said
    (tmp_path / "bad.cu").write_text("__device__ void k() {}")
    with pytest.raises(SimtError, match=r"bad\.cu has no kernel with these macros"):
        compile(Program(tmp_path / "bad.cu"))


def test_without_a_compiler_there_is_a_reason(monkeypatch):
    monkeypatch.setenv("CXX", "none-such -O3")
    assert "there is no none-such" in why_not()
    with pytest.raises(SimtError, match="there is no none-such"):
        compile(kernels_of("block_sum"))
