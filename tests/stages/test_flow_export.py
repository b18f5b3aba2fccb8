"""Names of exported files: safe for every file system, and no two alike."""

import pytest
from e4dgs.stages.exports.flow import SUFFIXES, pair_stems


def files(names: list[str], pairs: list[tuple[int, int]]) -> list[str]:
    return [stem + suffix for stem in pair_stems(names, pairs) for suffix in SUFFIXES]


def test_a_stem_names_both_frames():
    assert pair_stems(["train/r_000", "train/r_001", "cam01.mp4#7"], [(0, 1), (1, 2)]) == [
        "train-r_000_train-r_001",
        "train-r_001_cam01.mp4-7",
    ]


def test_names_sort_as_the_pairs_do():
    names = [f"cam0.mp4#{k}" for k in range(12)]
    pairs = [(k, k + 1) for k in range(11)]
    stems = pair_stems(names, pairs)
    assert stems == sorted(stems) and stems[2] == "02-cam0.mp4-2_cam0.mp4-3", "frame 10 comes after frame 9"
    for suffix in SUFFIXES:
        named = [stem + suffix for stem in pair_stems(["a", "a-b", "c"], [(0, 2), (1, 2)])]
        assert named == sorted(named)


@pytest.mark.parametrize(
    "name", ["../../etc/passwd", "/abs", "..", ".", ".hidden", "-rf", "a\0b", "a\nb", "c:\\x", "ß/é", "x" * 500, "", "$(rm) `x`;*?"]
)
def test_no_name_leaves_the_folder_or_needs_quotes(name):
    for file in files([name, "other"], [(0, 1)]):
        assert not set(file) - set("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789._-")
        assert file[0] not in ".-" and len(file) < 200


@pytest.mark.parametrize(
    ("names", "pairs"),
    [
        (["a b", "a/b", "c"], [(0, 2), (1, 2)]),  # both become a-b
        (["Left", "left", "c"], [(0, 2), (1, 2)]),  # one file where capitals do not count
        (["x_y", "z", "x", "y_z"], [(0, 1), (2, 3)]),  # x_y_z twice
        (["a", "b", "b_backward"], [(0, 1), (0, 2)]),  # the flow of one is the backward flow of the other
        (["\u00e9"] * 12, [(k, k + 1) for k in range(11)]),
    ],
)
def test_two_files_never_share_a_name(names, pairs):
    found = [file.lower() for file in files(names, pairs)]
    assert len(set(found)) == len(found) == len(SUFFIXES) * len(pairs)
