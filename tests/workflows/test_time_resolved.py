"""`--time` as pure functions: how times are written, what trainings take, and which of them fits."""

from dataclasses import replace
from itertools import pairwise

import pytest
from e4dgs.pipeline import SettingsError
from e4dgs.workflows.presets import PRESETS
from e4dgs.workflows.timing.ladder import LEAST_REFINEMENT, LEAST_STEPS, REFINEMENT, rung
from e4dgs.workflows.timing.resolve import PICTURES, TrainingTimes, choose, evaluation_within, refinement_within, shortest
from e4dgs.workflows.timing.size import frame_counts, largest_that_fits, most_that_fits, sizes
from e4dgs.workflows.timing.steps.costs import StepCosts, merged
from e4dgs.workflows.timing.steps.growth import Growth
from e4dgs.workflows.timing.words import seconds_of, words_for

HALF, FULL = 0.5, 1.0
COSTS = StepCosts(
    pieces=((0.5, HALF), (0.5, FULL)),
    measured={HALF: ((8000, 0.02), (24_000, 0.04)), FULL: ((24_000, 0.1), (40_000, 0.14))},
    growth=Growth(8000, {HALF: 24_000, FULL: 40_000}),
    round=16.0,
    removals=((60, False),),
    loads={HALF: 0.001, FULL: 0.004},
    pictures=60,
    setup=2.0,
)
TIMES = TrainingTimes(COSTS.seconds, lambda steps: 0.2 * steps, 3.0)


@pytest.mark.parametrize(
    ("text", "seconds", "words"),
    [
        ("90s", 90, "1m30s"),
        ("10m", 600, "10m"),
        ("10min", 600, "10m"),
        ("1h", 3600, "1h"),
        ("1h30m", 5400, "1h30m"),
        ("0.5h", 1800, "30m"),
        ("600S", 600, "10m"),
        ("1h0m5s", 3605, "1h5s"),
    ],
)
def test_times_are_written_as_people_write_them(text, seconds, words):
    assert seconds_of(text) == seconds
    assert words_for(seconds) == words and seconds_of(words) == seconds


@pytest.mark.parametrize("text", ["", "10", "m", "10x", "-5m", "5m10", "1m1h", "0s", "0.2s", "2000h", "nan", "1e3s", "10 m"])
def test_other_times_are_refused_in_one_line(text):
    with pytest.raises(SettingsError, match=r"--time .*expected") as error:
        seconds_of(text)
    assert "\n" not in str(error.value) and error.value.exit_code == 2


def test_the_presets_are_points_of_the_ladder():
    for name in ("fast", "default", "best"):
        preset = PRESETS[name]
        one = rung(preset.get("coarse.effort", 1.0), 20_000)
        assert one.steps == 20_000 * preset.get("coarse.effort", 1.0)
        assert one.refinement == REFINEMENT * preset.get("fine.effort", 1.0)
        assert one.share == preset.get("hulls.share", 0.2)


def test_more_effort_is_more_of_everything_up_to_best():
    rungs = [rung(0.01 * 1.1**k, 6000) for k in range(80)]
    for low, high in pairwise(rungs):
        assert low.steps <= high.steps and low.refinement <= high.refinement and low.share <= high.share
    assert rungs[0].steps == LEAST_STEPS and rungs[0].refinement >= LEAST_REFINEMENT
    assert rungs[-1].steps == 18_000 and rungs[-1] == rung(1e6, 6000), "more time than for best is not used"


def test_a_step_is_between_what_was_measured():
    assert COSTS.step(FULL, 32_000) == pytest.approx(0.12)
    assert COSTS.step(FULL, 0) == pytest.approx(0.04), "on the line through both measurements"
    assert COSTS.step(HALF, -1e6) > 0
    falling = replace(COSTS, measured={FULL: ((10, 0.2), (20, 0.1))})
    assert falling.step(FULL, 1e6) == pytest.approx(0.2), "more Gaussians never make a step cheaper"


def test_a_training_takes_what_its_steps_take():
    flat = replace(
        COSTS, measured={HALF: ((1, 0.02),), FULL: ((1, 0.1),)}, growth=Growth(10, {HALF: 10, FULL: 10}, grows=False), removals=()
    )
    loading = 60 * (0.001 + 0.004)
    assert flat.seconds(1000) == pytest.approx(2.0 + 500 * 0.02 + 500 * 0.1 + loading)
    grown = flat.seconds(1000) + 16 * (4 * 0.02 + 2 * 0.1)  # after 200, 300, 400 and 500 steps; after 600 and 700
    assert replace(flat, growth=replace(flat.growth, grows=True)).seconds(1000) == pytest.approx(grown)
    assert replace(flat, removals=((16, False), (16, True))).seconds(1000) == pytest.approx(flat.seconds(1000) + 16 * 0.1 * 1.4)


def test_growth_fills_what_there_is_room_for():
    growth = Growth(8000, {FULL: 40_000})
    count = 8000.0
    for step in range(200, 4600, 100):
        before, count = count, growth.after(step, 6000, count, FULL)
        assert before <= count <= 40_000
    assert count == pytest.approx(40_000)
    steady = Growth(2500, {FULL: 32_500}, 0.8, 150, steady=True)
    assert steady.every(40_000) == 266 and steady.every(1000) == 100
    assert steady.after(0, 15_000, 2500, FULL) == pytest.approx(2500 + 30_000 / 120)


def test_more_time_never_has_fewer_steps_and_is_kept():
    earlier = None
    for seconds in range(5, 6000, 190):
        found = choose(seconds, TIMES, 6000)
        if earlier is not None:
            assert found.rung.steps >= earlier.rung.steps and found.rung.refinement >= earlier.rung.refinement
            assert found.fits or not earlier.fits
        if found.fits:
            assert found.seconds <= seconds
            assert found.full or found.seconds > 0.9 * seconds, "and is used"
        earlier = found
    assert earlier.full and earlier.rung.steps == 18_000


def test_too_short_a_time_gives_the_shortest_sensible_training():
    least = shortest(TIMES, 6000)
    assert not choose(0.99 * least, TIMES, 6000).fits
    assert choose(0.99 * least, TIMES, 6000).rung == choose(-100.0, TIMES, 6000).rung == rung(0.0, 6000)
    assert choose(1.01 * least, TIMES, 6000).fits


def test_steps_that_the_user_chose_are_kept():
    found = choose(400.0, TIMES, 6000, fixed_steps=1234)
    assert found.rung.steps == 1234 and found.fits
    assert found.rung.refinement > choose(200.0, TIMES, 6000, fixed_steps=1234).rung.refinement


def test_a_stage_that_has_nothing_to_do_leaves_its_time():
    alone = choose(300.0, replace(TIMES, fine=None), 6000)
    assert alone.fine == 0.0 and alone.rung.steps > choose(300.0, TIMES, 6000).rung.steps


def test_refinement_takes_what_is_left():
    assert refinement_within(50.0, lambda steps: 5 + 0.1 * steps, 1500) == 450
    assert refinement_within(5000.0, lambda steps: 0.1 * steps, 1500) == 1500
    assert refinement_within(-5.0, lambda steps: 0.1 * steps, 1500) == LEAST_REFINEMENT
    assert refinement_within(-5.0, lambda steps: 0.1 * steps, 50) == 50


def test_an_evaluation_fits_too():
    def seconds(views, movies):
        return 2.0 + 1.0 * views + 0.1 * movies

    whole = evaluation_within(100.0, seconds, 40)
    assert (whole.measured, whole.movies) == (None, None) and whole.seconds == seconds(40, PICTURES[0])
    assert evaluation_within(35.0, seconds, 40).measured == 27
    assert evaluation_within(16.0, seconds, 40).movies == PICTURES[1]
    least = evaluation_within(0.0, seconds, 40)
    assert (least.measured, least.movies) == (8, 0)
    for time in range(100):
        assert evaluation_within(time, seconds, 40).seconds <= max(time, least.seconds)


def test_pictures_are_scaled_only_where_there_is_no_time():
    assert sizes(960) == [960, 768, 624, 480, 384] and sizes(400) == [400, 320] and sizes(128) == [128]
    needs = {side: side / 10 for side in sizes(960)}
    assert largest_that_fits(96.0, sizes(960), needs.__getitem__)[::2] == (960, True)
    assert largest_that_fits(60.0, sizes(960), needs.__getitem__)[::2] == (480, True)
    assert largest_that_fits(10.0, sizes(960), needs.__getitem__) == (384, 38.4, False)


def test_a_clip_loses_frames_before_its_pictures_get_small():
    assert frame_counts(600) == [600, 300, 198, 120] and frame_counts(130) == [130, 65] and frame_counts(50) == [50]

    def needs(count: int, side: int) -> float:
        return side / 10 + count / 5

    for seconds, *expected in ((216, 600, 960), (183, 600, 624), (182, 300, 960), (87, 120, 624), (63, 120, 384)):
        count, found = most_that_fits(seconds, frame_counts(600), sizes(960), needs)
        assert [count, found.side] == expected and found.fits
    assert not most_that_fits(62, frame_counts(600), sizes(960), needs)[1].fits


def test_costs_survive_a_file():
    assert StepCosts.of(COSTS.as_json()) == COSTS
    assert merged([(0.1, HALF), (0.4, HALF), (0.5, FULL)]) == ((0.5, HALF), (0.5, FULL))
    for broken in ({}, {**COSTS.as_json(), "growth": 3}, {**COSTS.as_json(), "measured": 5}):
        with pytest.raises((KeyError, TypeError, ValueError)):
            StepCosts.of(broken)
