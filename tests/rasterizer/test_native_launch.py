"""What the native launcher hands to the driver, against a library that takes the driver's place and notes it."""

import json
import os
import struct
import subprocess
import sys
from pathlib import Path

import pytest
from simt.compiler import needs_compiler

DRIVER = """
#include <stdio.h>
#include <string.h>
typedef unsigned long long word;
int cuLaunchKernel(void* kernel, unsigned gx, unsigned gy, unsigned gz, unsigned bx, unsigned by, unsigned bz, unsigned shared,
                   void* stream, void** parameters, void** extra) {
    word words[6];
    for (int i = 0; i < 6; ++i) memcpy(words + i, parameters[i], 8);
    fprintf(stderr, "%llu %u %u %u %u %u %u %u %llu %d", (word)kernel, gx, gy, gz, bx, by, bz, shared, (word)stream, !extra);
    for (int i = 0; i < 6; ++i) fprintf(stderr, " %llu", words[i]);
    fprintf(stderr, "\\n");
    return kernel == (void*)13 ? 700 : 0;
}
"""
CALLS = """
import ctypes, json, torch
from ctypes import c_bool, c_double, c_float, c_int32, c_int64, c_uint64
from e4dgs.rasterizer import _cpu
print(json.dumps(_cpu.launch(1, 2, 3, 4, -1, ())))  # nothing is known yet
assert _cpu.can_launch(torch.Tensor, c_float, c_double, c_uint64)
dense, other = torch.zeros(4), torch.zeros(4, 4).T
class Device(torch.Tensor):
    def get_device(self): return 0
one = (torch.nn.Parameter(dense), None, c_int32(-7), c_float(1.5), c_double(0.1), c_uint64(2**64 - 1))
print(json.dumps([_cpu.launch(kernel, 5, 128, 99, -1, one) for kernel in (12, 13)]))
print(dense.data_ptr())
wrong = [(other,), (dense.as_subclass(Device),), (7,), ("x",), tuple(one * 11)]
print(json.dumps([_cpu.launch(12, 1, 1, 0, -1, arguments) for arguments in wrong]))
"""


@needs_compiler
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="looks for libcuda.so.1")
def test_arguments_reach_the_driver_in_their_own_width_and_others_are_refused(tmp_path: Path) -> None:
    (tmp_path / "driver.c").write_text(DRIVER)
    subprocess.run(["cc", "-shared", "-fPIC", "-o", str(tmp_path / "libcuda.so.1"), str(tmp_path / "driver.c")], check=True)
    environment = {**os.environ, "LD_LIBRARY_PATH": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", CALLS], env=environment, capture_output=True, text=True, check=True, timeout=120)
    before, statuses, address, refused = done.stdout.splitlines()
    assert json.loads(before) == -1 and json.loads(statuses) == [0, 700] and json.loads(refused) == [-1] * 5
    single, double = struct.pack("<f", 1.5), struct.pack("<d", 0.1)
    words = [int(address), 0, (1 << 64) - 7, int.from_bytes(single, "little"), int.from_bytes(double, "little"), 2**64 - 1]
    wanted = [[kernel, 5, 1, 1, 128, 1, 1, 0, 99, 1, *words] for kernel in (12, 13)]
    assert done.stderr.splitlines() == [" ".join(map(str, row)) for row in wanted]
