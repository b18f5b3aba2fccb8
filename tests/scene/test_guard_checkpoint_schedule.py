"""What keeps a training alive: the guard, the checkpoint, the phases."""

import pytest
import torch
from e4dgs.scene.motion.nodes.schedule import first_motion, first_motion_steps, node_phases
from e4dgs.scene.motion.phases import Phase, alike_since, coarse_phases, fine_phases, left_to_fine
from e4dgs.scene.training.checkpoint import FILE, load_checkpoint, save_checkpoint
from e4dgs.scene.training.guard import MOST_IN_A_ROW, NonFiniteGuard, TrainingDiverged


def parameter(gradient):
    p = torch.zeros(3, requires_grad=True)
    p.grad = torch.tensor(gradient)
    return {"gaussians.means": p}


def test_guard_counts_and_forgives_single_accidents():
    guard = NonFiniteGuard()
    for _ in range(3 * MOST_IN_A_ROW):
        assert not guard.accepts(torch.tensor(1.0), parameter([0.0, float("inf"), 0.0]), 5, 2)
        assert guard.accepts(torch.tensor(1.0), parameter([0.0, 1.0, 0.0]), 6, 2)
    assert guard.count == 3 * MOST_IN_A_ROW


def test_guard_stops_and_names_step_frame_and_field():
    guard = NonFiniteGuard()
    with pytest.raises(TrainingDiverged, match=r"step 7, frame 3: gradients of gaussians.means"):
        for _ in range(MOST_IN_A_ROW):
            guard.accepts(torch.tensor(1.0), parameter([float("nan")] * 3), 7, 3)
    assert guard.count == MOST_IN_A_ROW


@pytest.mark.parametrize(
    ("gradient", "finite"),
    [([3e38, 3e38, 3e38], True), ([float("inf"), float("-inf"), 0.0], False), ([-3e38, 3e38, float("nan")], False)],
)
def test_guard_tells_a_sum_that_overflows_from_a_number_that_is_not_finite(gradient, finite):
    assert NonFiniteGuard().accepts(torch.tensor(1.0), parameter(gradient), 0, 0) == finite


def test_guard_refuses_a_non_finite_loss():
    assert not NonFiniteGuard().accepts(torch.tensor(float("nan")), parameter([0.0, 0.0, 0.0]), 0, 0)


def test_checkpoint_round_trip_and_damage(tmp_path):
    assert load_checkpoint(tmp_path) is None
    tensors = {"a": torch.arange(5.0), "flag": torch.tensor([True, False])}
    save_checkpoint(tmp_path, tensors, {"iteration": 7})
    loaded, state = load_checkpoint(tmp_path)
    assert state == {"iteration": 7} and torch.equal(loaded["a"], tensors["a"]) and torch.equal(loaded["flag"], tensors["flag"])
    assert [p.name for p in tmp_path.iterdir()] == [FILE]
    whole = (tmp_path / FILE).read_bytes()
    for size in (0, 7, len(whole) // 2, len(whole) - 1):
        (tmp_path / FILE).write_bytes(whole[:size])
        assert load_checkpoint(tmp_path) is None


@pytest.mark.parametrize("strategy", ["two-stage", "joint", "alternating", "progressive"])
def test_every_strategy_spends_the_same_steps(strategy):
    phases = coarse_phases(strategy, 1000, static=False) + fine_phases(strategy, 1000, 300, static=False)
    assert sum(p.iterations for p in phases) == 1300
    assert not phases[0].move and phases[-1].move


def test_what_each_strategy_is():
    assert [p.name for p in coarse_phases("joint", 1000, False)] == ["warm-up"]
    assert {p.scale for p in coarse_phases("progressive", 1000, False)} == {0.25, 0.5}
    assert fine_phases("progressive", 1000, 300, False)[0].scale == 1.0
    assert fine_phases("alternating", 1000, 300, False)[0].alternation > 0
    assert fine_phases("two-stage", 1000, 300, False)[0].alternation == 0


@pytest.mark.parametrize(
    ("full_from", "expected"),
    [
        (0.0, [("warm-up", 100, 1.0), ("deformation", 900, 1.0)]),
        (0.05, [("warm-up", 50, 0.5), ("warm-up", 50, 1.0), ("deformation", 900, 1.0)]),
        (0.75, [("warm-up", 100, 0.5), ("deformation", 650, 0.5), ("deformation", 250, 1.0)]),
        (1.0, [("warm-up", 100, 0.5), ("deformation", 900, 0.5)]),
    ],
)
def test_images_grow_to_full_size_during_coarse(full_from, expected):
    assert [(p.name, p.iterations, p.scale) for p in coarse_phases("two-stage", 1000, False, full_from)] == expected
    assert sum(p.iterations for p in coarse_phases("two-stage", 777, True, full_from)) == 777


@pytest.mark.parametrize("strategy", ["two-stage", "alternating", "progressive"])
def test_motion_that_is_known_has_no_warm_up_without_it(strategy):
    rest, known = (coarse_phases(strategy, 1000, False, 0.75, from_rest=from_rest) for from_rest in (True, False))
    assert sum(p.iterations for p in rest if p.name == "warm-up" and not p.move) == 100 and not rest[0].move
    assert [p.name for p in known] == ["deformation"] * len(known) and all(p.move for p in known)
    for phases in (rest, known):
        small = sum(p.iterations for p in phases if p.scale == phases[0].scale)
        assert sum(p.iterations for p in phases) == 1000 and small == (500 if strategy == "progressive" else 750)


@pytest.mark.parametrize(("strategy", "static"), [("joint", False), ("joint", True), ("two-stage", True)])
def test_stages_that_do_not_move_are_as_they_were_where_motion_is_known(strategy, static):
    known = coarse_phases(strategy, 1000, static, from_rest=False)
    assert known == coarse_phases(strategy, 1000, static, from_rest=True) and known and not any(p.move for p in known)


def test_static_scenes_never_move():
    assert not any(p.move for p in coarse_phases("two-stage", 1000, True) + fine_phases("two-stage", 1000, 300, True))
    assert sum(p.iterations for p in fine_phases("joint", 1000, 300, True)) == 300


@pytest.mark.parametrize("scale", [0.5, 1.0])
def test_nodes_see_small_images_first_and_full_size_for_most_of_the_steps(scale):
    phases = node_phases(1000, scale)
    assert sum(p.iterations for p in phases) == 1000 and [p.move for p in phases] == [False, True, True]
    assert [p.scale for p in phases] == [scale, scale, 1.0] and phases[-1].iterations >= 900


@pytest.mark.parametrize(("steps", "first"), [(0, 0), (30, 20), (6000, 4000), (5999, 3999), (40_000, 4000)])
@pytest.mark.parametrize(("small", "scale"), [(False, 0.25), (True, 0.5)])
def test_nodes_look_for_the_motion_on_very_small_images_first(steps, first, small, scale):
    assert first_motion_steps("two-stage", steps) == first and first_motion_steps("joint", steps) == 0
    training = first_motion("two-stage", steps, small)
    assert training is not None and training.recipe.rigid_parts_at == () and first_motion("joint", steps, small) is None
    phases = training.phases
    assert sum(p.iterations for p in phases) == first
    assert all(p.scale == scale and p.move == (p.name == "motion") for p in phases)


def test_losses_of_another_image_size_do_not_compare():
    phases = [Phase("a", 100, False, 0.5), Phase("b", 200, True, 0.5), Phase("c", 300, True, 1.0), Phase("d", 50, True, 1.0)]
    assert [alike_since(phases, step) for step in (50, 100, 101, 300, 301, 600, 650)] == [0, 0, 100, 100, 300, 300, 300]


@pytest.mark.parametrize("static", [False, True])
@pytest.mark.parametrize("strategy", ["two-stage", "joint", "alternating", "progressive"])
def test_what_coarse_leaves_to_fine_is_what_it_did_not_do(strategy, static):
    done = sum(p.iterations for p in coarse_phases(strategy, 1000, static))
    left = left_to_fine(strategy, 1000, static)
    assert done + left == 1000 and sum(p.iterations for p in fine_phases(strategy, 1000, 300, static)) == left + 300
