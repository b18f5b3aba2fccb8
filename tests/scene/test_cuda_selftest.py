"""The proof that a GPU trains as the CPU does, on the emulator: it holds there, it launches every kernel, and it fails if one is wrong."""

import re
from ctypes import c_float
from functools import cache, partial
from pathlib import Path

import pytest
import torch
from e4dgs.rasterizer.cuda.selftest import disagreement
from e4dgs.scene import selftest
from pretend_cuda import pretending_cuda
from simt import Emulator, needs_compiler

pytestmark = needs_compiler
ROOT = Path(__file__).resolve().parents[2]
DECLARED = re.compile(r'extern "C" __global__ void(?: __launch_bounds__\([^)]*\))?\s+(\w+)\(')
NOT_BY_DEFAULT = {"sum_slots", "sum_links"}  # only with torch.use_deterministic_algorithms(True)


class OneWrong(Emulator):
    """An emulator in which one kernel is wrong: all floats that it is given as such or writes are too large by a hundredth, all flags are
    inverted.

    of: only in programs whose features contain this name.
    """

    def __init__(self, wrong: str, of: str = "") -> None:
        super().__init__()
        self.wrong, self.of = wrong, of

    def launch(self, program, kernel, blocks, threads, *arguments):
        spoiled = kernel == self.wrong and self.of in str(program)
        tensors = [argument for argument in arguments if isinstance(argument, torch.Tensor)] if spoiled else []
        before = [tensor.clone() for tensor in tensors]
        if spoiled:  # a kernel may write to addresses in a table, which are not seen here
            arguments = tuple(c_float(1.01 * a.value) if isinstance(a, c_float) else a for a in arguments)
        super().launch(program, kernel, blocks, threads, *arguments)
        for tensor, old in zip(tensors, before):
            if not torch.equal(tensor, old):  # it was written
                if tensor.is_floating_point():
                    tensor *= 1.01
                else:
                    tensor.copy_(1 - tensor)


@cache
def on_cpu():
    return selftest._step("planes", "cpu")


class Noting(Emulator):
    """An emulator that remembers what it was asked to run."""

    def __init__(self) -> None:
        super().__init__()
        self.programs = set()

    def launch(self, program, *given):
        self.programs.add(program)
        super().launch(program, *given)


def test_the_proof_holds_and_covers_every_kernel():
    emulator = Noting()
    with pretending_cuda(emulator=emulator) as pretending:
        assert selftest.problem("cuda") is None
    assert emulator.programs == set(selftest.programs_used()), "these are compiled together, ahead"
    declared = {
        name
        for floor in ("rasterizer", "scene")
        for path in (ROOT / floor / "cuda").glob("*.cu")
        for name in DECLARED.findall(path.read_text())
    }
    assert len(declared) > 20 and declared - set(pretending.kernels) == NOT_BY_DEFAULT


@pytest.mark.parametrize(
    ("kernel", "named"),
    [
        ("adam_rows", "the step of gaussians"),
        ("check_gradients", "the step of gaussians"),
        ("displace_backward", "the gradient of"),
        ("look_up", "the loss|the render|the gradient"),
        ("spread_lines", "the gradient of motion.planes.time"),
        ("photometric_gradient", "the gradient of"),
        ("smoothness_gradient", "the gradient of motion.planes"),
        ("blend_backward", "the gradient of gaussians"),
    ],
)
def test_a_kernel_that_is_wrong_is_noticed(kernel, named):
    with pretending_cuda(emulator=OneWrong(kernel)):
        found = disagreement(on_cpu, partial(selftest._step, "planes", "cuda"))
    assert re.search(rf"compute something else than the CPU's: ({named})", found or ""), found


def test_the_step_on_nodes_notices_a_wrong_program_of_the_antialiased_mode():
    """Models are trained in that mode by default, and its programs are compiled apart."""
    with pretending_cuda(emulator=OneWrong("backproject_gaussians", "ANTIALIASED=1")):
        found = disagreement(partial(selftest._step, "nodes", "cpu"), partial(selftest._step, "nodes", "cuda"))
    assert re.search("compute something else than the CPU's: the gradient of gaussians", found or ""), found


@pytest.mark.parametrize(
    ("motion", "kernel", "named"),
    [
        ("lifetimes", "live", "the loss|the render"),
        ("lifetimes", "live_backward", "the gradient of (gaussians|convexes)"),
        ("nodes", "skin", "the loss|the render"),
        ("nodes", "skin_backward", "the gradient of (gaussians|convexes|field)"),
    ],
)
def test_the_steps_on_other_motions_notice_their_kernels(motion, kernel, named):
    with pretending_cuda(emulator=OneWrong(kernel)):
        found = disagreement(partial(selftest._step, motion, "cpu"), partial(selftest._step, motion, "cuda"))
    assert re.search(rf"compute something else than the CPU's: ({named})", found or ""), found


def test_what_only_one_of_them_computes_is_named():
    one, two = {"the loss": torch.ones(1)}, {"the loss": torch.ones(1), "the gradient of x": torch.ones(1)}
    assert "only one of them has the gradient of x" in (disagreement(lambda: one, lambda: two) or "")
    assert disagreement(lambda: one, lambda: dict(one)) is None
    assert "do not run here: KeyError" in (disagreement(lambda: one, lambda: {}["x"]) or "")
