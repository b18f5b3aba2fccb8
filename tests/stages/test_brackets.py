"""Exposure brackets among photos: of each view, the middle exposure is used, and the plan says so."""

import math

import pytest
from e4dgs.pipeline import CaptureError
from e4dgs.stages.captures import recognise
from e4dgs.stages.captures.exposure import exposure
from e4dgs.stages.captures.listing.names import in_order
from PIL import Image
from PIL.TiffImagePlugin import IFDRational


def photo(file, second=None, stops=None, fraction=None, iso=100):
    """A picture taken ``second`` s after noon, with 1/100 s times two to the ``stops`` of light."""
    data = Image.Exif()
    details = data.get_ifd(0x8769)
    if stops is not None:
        details |= {0x829A: IFDRational(1, round(100 / 2**stops * iso / 100)), 0x8827: iso, 0x829D: IFDRational(28, 10)}
    if second is not None:
        details[0x9003] = f"2024:01:01 12:{second // 60:02d}:{second % 60:02d}"
    if fraction is not None:
        details[0x9291] = fraction
    Image.new("RGB", (16, 12), (100, 0, 0)).save(file, exif=data)


def shoot(root, stops, views=4, gap=10, single=0):
    for i in range(views * len(stops)):
        photo(root / f"IMG_{i:04d}.JPG", gap * (i // len(stops)) + i % len(stops) // 3, stops[i % len(stops)])
    for k in range(single):
        photo(root / f"IMG_{views * len(stops) + k:04d}.JPG", 1000 + 20 * k, 0.0)


def told(found):
    return [note for note in found.notes if "exposures" in note]


def test_what_exif_data_say(tmp_path):
    photo(tmp_path / "a.jpg", 61, 2.0, "250")
    photo(tmp_path / "b.jpg", 60, 0.0, iso=400)
    photo(tmp_path / "c.jpg", 60)
    photo(tmp_path / "d.jpg", None, 1.0)
    photo(tmp_path / "e.jpg", 60, 1.0, "x")
    (tmp_path / "f.jpg").write_bytes(b"x")
    one, other = exposure(tmp_path / "a.jpg"), exposure(tmp_path / "b.jpg")
    assert one.second - other.second == pytest.approx(1.25) and one.stops - other.stops == pytest.approx(2.0)
    assert one.stops == pytest.approx(math.log2(0.04 * 100 / 2.8**2))
    assert exposure(tmp_path / "c.jpg") is exposure(tmp_path / "d.jpg") is exposure(tmp_path / "f.jpg") is None
    assert exposure(tmp_path / "e.jpg").second == other.second


@pytest.mark.parametrize(
    ("stops", "middle"), [((0, -2, 2), 0), ((-2, 0, 2), 1), ((0, -1, 1, -2, 2), 0), ((-2, -1.33, -0.66, 0, 0.66, 1.33, 2), 3)]
)
def test_of_each_view_the_middle_exposure_is_used(tmp_path, stops, middle):
    shoot(tmp_path, stops)
    found = recognise(tmp_path, static=True)
    size = len(stops)
    assert list(found.files) == [f"IMG_{size * k + middle:04d}.JPG" for k in range(4)]
    assert told(found) == [
        f"4 views with {size} exposures each (brackets, by EXIF data; the first is IMG_0000.JPG to IMG_{size - 1:04d}.JPG): the middle "
        f"exposure is used, and {4 * (size - 1)} photos are left out; to use others, put them alone into a folder"
    ]
    assert not [note for note in found.notes if "not read" in note], "said once"


def test_photos_between_brackets_stay(tmp_path):
    shoot(tmp_path, (0, -2, 2), single=3)
    assert len(recognise(tmp_path, static=True).files) == 4 + 3


@pytest.mark.parametrize("stops", [(0, 0, 0), (0, 0.1, 0.2), (0, -2, 0.7)], ids=["one exposure", "an automatic one", "an uneven one"])
def test_other_photos_are_all_used(tmp_path, stops):
    shoot(tmp_path, stops)
    found = recognise(tmp_path, static=True)
    assert len(found.files) == 12 and not told(found)


def test_a_few_that_change_evenly_are_chance(tmp_path):
    shoot(tmp_path, (0, -2, 2), views=1, single=6)
    found = recognise(tmp_path, static=True)
    assert len(found.files) == 9 and not told(found)


def test_exposures_minutes_apart_are_no_bracket(tmp_path):
    for i in range(12):
        photo(tmp_path / f"IMG_{i:04d}.JPG", 100 * i, (0, -2, 2)[i % 3])
    assert len(recognise(tmp_path, static=True).files) == 12


def test_one_view_is_no_scene(tmp_path):
    shoot(tmp_path, (0, -2, 2), views=1)
    with pytest.raises(CaptureError, match=r"1 view with 3 exposures.*add more views"):
        recognise(tmp_path, static=True)


@pytest.mark.parametrize("dated", [True, False])
def test_photos_whose_names_give_no_order_follow_their_dates(tmp_path, dated):
    """Names as phones share them; without dates, the order of the names is doubted."""
    names = [f"{hex}-BDC0-329A.JPEG" for hex in ("0F2B", "A7D1", "3B3A", "E3C7", "9E0D", "7133")]
    for k, name in enumerate(names):
        photo(tmp_path / name, 10 * k if dated else None)
    capture = recognise(tmp_path)
    assert list(capture.names) == (names if dated else in_order(names))
    (note,) = [note for note in capture.notes if "give no order" in note]
    assert note.endswith(f"so the EXIF dates do: {names[0]} to {names[-1]}" if dated else "use --static if nothing moves")
    assert not any("give no order" in note for note in recognise(tmp_path, static=True).notes)
