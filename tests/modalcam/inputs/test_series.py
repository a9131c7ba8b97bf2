import numpy as np
import pandas as pd
import pytest
from kit.tracks import rectified_tracks, sample_tracks

from modalcam.common import InputError
from modalcam.inputs import is_tracks, read_table, series_from_table, tracks_from_table, with_known_input
from modalcam.tables import write_tracks


def table_of(tmp_path, text):
    path = tmp_path / "series.csv"
    path.write_text(text)
    return read_table(path)


def test_uneven_times_and_gaps_are_kept(tmp_path):
    times = [0, 1, 2.5, 3, 4, 6, 7, 8, 9]
    cells = ["1", "2", "", "4", "5", "6", "7", "8", "9"]
    rows = "\n".join(f"{t},{v},0.1" for t, v in zip(times, cells, strict=True))
    series = series_from_table(table_of(tmp_path, "time_s,a,sd_a\n" + rows), name="x", unit="g")
    assert series.channels == ("a",)
    assert series.time_s.tolist() == [0, 1, 2.5, 3, 4, 6, 7, 8, 9]
    assert np.isnan(series.values[2, 0])
    assert series.values[3, 0] == 4
    assert np.all(series.sd == 0.1)
    assert series.unit == "g"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("b,a\n1,2", "expected a column time_s"),
        ("time_s\n" + "\n".join(map(str, range(9))), "at least one channel"),
        ("time_s,a\n0,1\n1,2", "at least 8 samples"),
        ("time_s,a\n" + "\n".join(f"{t},1" for t in [0, 1, 2, 3, 2, 5, 6, 7, 8]), "must increase"),
        (
            "time_s,a\n" + "\n".join(f"{t}e300,1" for t in range(9)),
            "in seconds, found a record of 8e\\+300 s",
        ),
        ("time_s,a\n" + "\n".join(f"{t}e-300,1" for t in range(9)), "in seconds, found a record of 8e-300 s"),
        ("time_s,a\n" + "\n".join(f"{t},one" for t in range(9)), "column a is not numeric"),
        ("", "header row"),
    ],
)
def test_errors_are_named(tmp_path, text, words):
    with pytest.raises(InputError, match=words):
        series_from_table(table_of(tmp_path, text), name="x", unit="1")


def test_a_missing_file(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        read_table(tmp_path / "absent.csv")


def test_a_tracks_file_is_read_back(tmp_path):
    tracks = sample_tracks()
    path = tmp_path / "a.csv"
    write_tracks(path, tracks)
    table = read_table(path)
    assert is_tracks(table)
    back = tracks_from_table(table, name="a", positions_mm=None, reference=())
    for name in ["x_px", "y_px", "sd_x_px", "sd_y_px", "time_s", "flags", "frame"]:
        assert np.array_equal(getattr(back, name), getattr(tracks, name), equal_nan=True), name
    assert back.markers == tracks.markers
    assert back.scale.mm_per_px == pytest.approx(tracks.scale.mm_per_px, rel=1e-12)


def test_rectified_tracks_keep_their_positions_in_mm(tmp_path):
    tracks, path = rectified_tracks(), tmp_path / "a.csv"
    write_tracks(path, tracks)
    back = tracks_from_table(read_table(path), name="a", positions_mm=None, reference=())
    assert back.x_mm == pytest.approx(tracks.x_mm, rel=1e-8, nan_ok=True)
    assert back.y_mm == pytest.approx(tracks.y_mm, rel=1e-8, nan_ok=True)
    assert back.sd_y_mm == pytest.approx(tracks.sd_y_mm, rel=1e-8, nan_ok=True)


def test_a_missing_row_is_rejected(tmp_path):
    path = tmp_path / "a.csv"
    write_tracks(path, sample_tracks())
    lines = path.read_text().splitlines()
    path.write_text("\n".join(lines[:3] + lines[4:]))
    with pytest.raises(InputError, match="one row per frame and marker"):
        tracks_from_table(read_table(path), name="a", positions_mm=None, reference=())


def test_columns_of_the_tracks_file(tmp_path):
    path = tmp_path / "a.csv"
    write_tracks(path, sample_tracks())
    table = pd.read_csv(path)
    names = "frame time_s marker x_px y_px sd_x_px sd_y_px x_mm y_mm sd_x_mm sd_y_mm flags"
    assert " ".join(table.columns) == names
    assert len(table) == 12 * 2


def test_a_force_is_known_by_the_unit_in_its_name(tmp_path):
    text = "time_s,hammer [N],tip [g]\n" + "".join(f"{0.01 * k},{k % 3},{k % 5}\n" for k in range(30))
    motion = {"series": series_from_table(table_of(tmp_path, text), name="x", unit="1")}
    series = with_known_input(motion, "hammer [N]", None)["series"]
    assert (series.unit, series.known_input.unit, series.known_input.is_force) == ("g", "N", True)
    assert with_known_input(motion, "hammer [N]", "kN")["series"].known_input.unit == "kN"
