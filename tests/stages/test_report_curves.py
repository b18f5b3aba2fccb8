"""What the report draws over time, and the sum of the time that it tells of."""

import pytest
from e4dgs.stages.report.curves import over_time
from e4dgs.stages.report.page import total_of


def pair(camera: int, begin: float, static: float | None, edges: float | None, warped: float | None = None) -> dict:
    return {"camera": camera, "times": [begin, begin + 0.5], "static": static, "edges": edges, "warped": warped, "flow": 0.1}


def test_flicker_has_a_point_for_each_pair_of_times_the_mean_of_its_cameras():
    rows = [pair(0, 0.0, 1.0, 2.0), pair(0, 0.5, 3.0, None), pair(2, 0.5, 5.0, 4.0), pair(2, 0.0, None, 6.0, 7.0)]
    (plot,) = over_time({"flicker": {"static": 3.0, "edges": 4.0, "per_pair": rows}})
    curves = {series.label: series.points for series in plot.series}
    assert curves == {
        "where nothing moves": [(0.25, 1.0), (0.75, 4.0)],
        "at edges": [(0.25, 4.0), (0.75, 4.0)],
        "along the motion": [(0.25, 7.0)],
    }
    assert plot.y_label == "levels"


def test_psnr_over_time_is_the_mean_of_the_views_of_a_time_test_first():
    views = [{"time": t, "psnr": psnr} for t, psnr in ((1.0, 30.0), (0.0, 20.0), (0.0, 24.0), (1.0, None))]
    splits = {"train": {"per_view": views}, "test": {"per_view": views[:2]}, "val": {"per_view": views[:1]}}
    found = over_time({"splits": splits, "flicker": None})
    assert [plot.title for plot in found if plot.series] == ["PSNR over time, test", "PSNR over time, train"]
    assert found[1].series[0].points == [(0.0, 22.0), (1.0, 30.0)]


@pytest.mark.parametrize("metrics", [{}, {"flicker": None}, {"flicker": {"static": 1.0}}])
def test_without_rows_there_is_no_curve(metrics):
    assert not any(plot.series for plot in over_time(metrics))


def test_the_total_counts_what_ran_and_what_was_kept():
    rows = [{"state": state, "seconds": seconds} for state, seconds in (("ran", 2.0), ("cached", 60.0), ("skipped", 9.0), ("ran", None))]
    assert total_of(rows) == {"seconds": 62.0, "cached": 60.0}
    assert total_of([]) == {"seconds": 0, "cached": 0}
