"""How long a film is: real time by default, and options that fit one another."""

import pytest
from e4dgs.pipeline import SettingsError
from e4dgs.workflows.exports.film import Asked


@pytest.mark.parametrize(
    ("given", "natural", "count", "fps"),
    [
        ((None, None, None), 59 / 30, 60, 30.0),  # a capture of 60 pictures at 30 a second
        ((None, None, None), None, 120, 30.0),
        ((None, None, 24.0), 2.0, 49, 24.0),
        ((None, 10.0, None), 2.0, 300, 30.0),
        ((None, 10.0, 24.0), 2.0, 240, 24.0),
        ((90, None, None), 2.0, 90, 30.0),
        ((90, None, 60.0), 2.0, 90, 60.0),
        ((50, 2.0, None), 9.0, 50, 25.0),
        ((50, 2.0, 25.0), 9.0, 50, 25.0),
        ((None, 0.01, None), None, 1, 30.0),
    ],
)
def test_a_path_by_name(given, natural, count, fps):
    film = Asked(*given).film(natural)
    assert (film.count, film.fps) == (count, fps)


@pytest.mark.parametrize(
    ("given", "fps", "expected"),
    [((None, None, None), None, 30), ((None, None, None), 24.0, 24), ((None, None, 60.0), 24.0, 60), ((None, 5.0, None), 24.0, 20)],
)
def test_a_path_file_has_its_own_rate(given, fps, expected):
    assert Asked(*given).film_of(100, fps).fps == expected


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ((10, 2.0, 30.0), "makes 60 pictures, not 10; leave one of them out"),
        ((10, 100.0, None), "0.1 pictures a second, but 1 to 240"),
        ((1000, 1.0, None), "1000 pictures a second"),
        ((None, 1e6, None), "more than 100000"),
        ((None, float("nan"), None), "--seconds nan: give a number"),
        ((None, None, float("inf")), "--fps inf: give a number"),
    ],
)
def test_what_does_not_fit_is_refused(given, words):
    with pytest.raises(SettingsError, match=words):
        Asked(*given).film(None)


@pytest.mark.parametrize(
    ("given", "fps", "words"),
    [((5, None, None), None, "leave --frames out"), ((None, 1.0, None), None, "500 pictures"), ((None, None, None), 500.0, "file's rate")],
)
def test_a_path_file_refuses_what_it_decides_itself(given, fps, words):
    with pytest.raises(SettingsError, match=words):
        Asked(*given).film_of(500, fps)
