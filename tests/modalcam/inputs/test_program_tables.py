"""Tables of Kinovea, Tracker, DICe, DeepLabCut and phyphox, made from the documentation or source of each program."""

import numpy as np
import pandas as pd
import pytest
from kit.series import decay

from modalcam.common import ExitCode, InputError
from modalcam.inputs import read_table, series_from_table

TIME_S = np.arange(40) / 250.0
MOTION = np.round(np.random.default_rng(4).standard_normal((40, 2)), 6)
PHYPHOX = ["Time (s)", "Acceleration x (m/s^2)", "Acceleration y (m/s^2)"]
DICE = (
    "***\n*** Digital Image Correlation Engine (DICe), Copyright 2015 Sandia Corporation\n***\n"
    "*** Shape functions: Translation (u,v) Rotation (theta) \n"
    "*** Coordinates given with (0,0) as upper left corner of image, x positive right, y positive down\n***\n"
)


def rows(*columns, separator=",", number="{:.6f}".format):
    return "".join(separator.join(map(number, row)) + "\n" for row in np.column_stack(columns))


def scientific(value):
    """As Java's DecimalFormat 0.000000000E0 writes it: an exponent without a plus sign and leading zeros."""
    mantissa, exponent = f"{value:.9E}".split("E")
    return f"{mantissa}E{int(exponent)}"


def comma(value):
    return scientific(value).replace(".", ",")


def quoted(names, separator=","):
    return separator.join(f'"{name}"' for name in names) + "\n"


def assert_read(path, text, names, rate_hz=None, motion=MOTION):
    path.write_text(text, "utf-8")
    table = read_table(path, rate_hz)
    series = series_from_table(table, name="a", unit="px")
    assert list(series.channels) == names
    np.testing.assert_allclose(series.time_s - series.time_s[0], TIME_S, atol=1e-12)
    np.testing.assert_array_equal(series.values, motion)
    return table, series


@pytest.mark.parametrize(
    ("separator", "number"), [(",", scientific), (";", comma), ("\t", scientific), ("\t", comma)]
)
def test_phyphox_csv(tmp_path, separator, number):
    """CsvFormat in phyphox/phyphox-android, app/src/main/java/de/rwth_aachen/phyphox/DataExport.java.

    The modulus that its experiment with the acceleration exports too has half the period of the motion.
    """
    names = [*PHYPHOX, "Absolute acceleration (m/s^2)"]
    table = rows(TIME_S, MOTION, np.hypot(*MOTION.T), separator=separator, number=number)
    read, _ = assert_read(tmp_path / "Raw Data.csv", quoted(names, separator) + table, PHYPHOX[1:])
    assert any("Absolute acceleration (m/s^2), a modulus, is left out" in note for note in read.notes)


def test_a_channel_that_is_called_absolute_is_no_modulus_without_components(tmp_path):
    names = ["Time (s)", "Absolute position (mm)", "Relative position (mm)"]
    assert_read(tmp_path / "a.csv", quoted(names) + rows(TIME_S, MOTION), names[1:])


def test_phyphox_xlsx(tmp_path):
    """ExcelFormat in the same file: a sheet of a name and numbers for each set, and sheets on the device."""
    openpyxl = pytest.importorskip("openpyxl", reason="the extra modalcam[xlsx] is not installed")
    book = openpyxl.Workbook()
    sheet = book.active
    sheet.title = "Raw Data"
    for row in [PHYPHOX, *np.column_stack([TIME_S, MOTION]).tolist()]:
        sheet.append(row)
    book.create_sheet("Metadata Device").append(["property", "value"])
    book.save(tmp_path / "a.xlsx")
    table = read_table(tmp_path / "a.xlsx")
    assert list(table.columns) == ["time_s", *PHYPHOX[1:]]
    np.testing.assert_array_equal(table.columns, np.column_stack([TIME_S, MOTION]))
    (tmp_path / "b.xlsx").write_bytes((tmp_path / "a.xlsx").read_bytes()[:-300])
    with pytest.raises(InputError, match="no readable workbook"):
        read_table(tmp_path / "b.xlsx")
    openpyxl.Workbook().save(tmp_path / "c.xlsx")
    with pytest.raises(InputError, match="first sheet is empty"):
        read_table(tmp_path / "c.xlsx")


@pytest.mark.parametrize("decimal", [".", ","])
def test_kinovea_csv(tmp_path, decimal):
    """https://kinovea.readthedocs.io/en/latest/export/data.html: time in ms, then the data sources.

    Cells, quotes and the separator of lists beside decimal commas: CSVHelper in Kinovea/Kinovea.
    """
    separator = "," if decimal == "." else ";"
    names = quoted(["Time (ms)", "Tip", "Middle"], separator)
    table = rows(1e3 * TIME_S, MOTION, separator=separator, number=lambda v: f"{v:.6f}".replace(".", decimal))
    assert_read(tmp_path / "a.csv", names + table, ["Tip", "Middle"])


def test_kinovea_csv_of_trajectories_needs_the_rate(tmp_path):
    """WriteHeaders of the CSV export of trajectories in Kinovea/Kinovea: a time without its unit, name/point/axis."""
    names = ["Tip/0/X", "Tip/0/Y"]
    text = quoted(["Time", *names]) + rows(40.0 * np.arange(40), MOTION)
    assert_read(tmp_path / "a.csv", text, names, 250.0)
    with pytest.raises(InputError, match="give --rate"):
        read_table(tmp_path / "a.csv")


@pytest.mark.parametrize("decimal", [".", ","])
def test_kinovea_text_of_several_trajectories_needs_the_rate(tmp_path, decimal):
    """ExporterTXTTrajectory.cs in Kinovea/Kinovea: one block a trajectory, times in the unit of a setting.

    The second trajectory was lost in two frames.
    """
    seen = np.delete(np.arange(40), [5, 6])

    def block(name, k):
        table = rows(40.0 * k, MOTION[k], separator=" ", number=lambda v: f"{v:.6f}".replace(".", decimal))
        return f"# {name}\n{table}\n"

    text = "#Kinovea Trajectory data export\n#T X Y\n\n" + block("Tip", np.arange(40)) + block("Mid", seen)
    expected = np.column_stack([MOTION, np.where(np.isin(np.arange(40), seen)[:, None], MOTION, np.nan)])
    path = tmp_path / "a.txt"
    assert_read(path, text, ["Tip X", "Tip Y", "Mid X", "Mid Y"], 250.0, expected)
    with pytest.raises(InputError, match="give --rate"):
        read_table(path)
    renamed = text.replace("# Mid", "# Tip")
    assert_read(path, renamed, ["Tip 1 X", "Tip 1 Y", "Tip 2 X", "Tip 2 Y"], 250.0, expected)


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("0:00:00:00 866.00 320.00 \n0:00:00:03 847.00 321.00 \n", "export CSV by its Tools"),
        ("# Tip\n0 1 2\n", "without trajectories"),
        ("# Tip\n0 1 2\n0 1 2\n", "without trajectories"),
        ("# Tip\n0 1 2\n1 1 2\n2.5 1 2\n", "from frame to frame"),
    ],
    ids=["time codes of versions before 0.9", "one row", "equal times", "between frames"],
)
def test_other_texts_of_kinovea_are_refused(tmp_path, body, words):
    path = tmp_path / "a.txt"
    path.write_text(f"#Kinovea Trajectory data export\n#T X Y\n{body}")
    with pytest.raises(InputError, match=words):
        read_table(path, 250.0)


@pytest.mark.parametrize("separator", ["\t", ",", ";"])
def test_tracker(tmp_path, separator):
    """Data files of Tracker: the name of the track, the names of the columns, the rows.

    saveAsAction in OpenSourcePhysics/tracker, src/org/opensourcephysics/cabrillo/tracker/ExportDataDialog.java;
    separators, numbers and empty cells: its help, tableview.html. A track ends before the other values do.
    """
    table = rows(TIME_S, MOTION, separator=separator, number=scientific).splitlines()
    table[-1] = table[-1].rpartition(separator)[0] + separator
    holed = MOTION.copy()
    holed[-1, 1] = np.nan
    text = "mass_A\n" + separator.join(("t", "x", "y")) + "\n" + "\n".join(table) + "\n"
    assert_read(tmp_path / "a.txt", text, ["x", "y"], motion=holed)


def test_a_solution_of_dice_has_its_standard_deviations(tmp_path):
    """dicengine/dice, tests/examples/mechanism/gold/DICe_solution_0.txt; issues 133 and 218 on SIGMA."""
    sigma = np.full(40, 0.0379)
    sigma[3] = -1.0
    names = "FRAME,COORDINATE_X,COORDINATE_Y,DISPLACEMENT_X,DISPLACEMENT_Y,ROTATION_Z,SIGMA,GAMMA\n"
    place, zeros = np.full((40, 2), 266.0), np.zeros(40)
    table = rows(np.arange(1, 41), place, MOTION, zeros, sigma, zeros, number=lambda v: f"{v:.8E}")
    holed = MOTION.copy()
    holed[3] = np.nan
    read, series = assert_read(
        tmp_path / "a.txt", DICE + names + table, ["DISPLACEMENT_X", "DISPLACEMENT_Y"], 250.0, holed
    )
    np.testing.assert_array_equal(series.sd[:, 0], np.where(sigma > 0.0, sigma, np.nan))
    assert any("failed in 1 frame(s)" in note for note in read.notes)


def test_a_solution_of_dice_of_one_frame_is_refused(tmp_path):
    """dicengine/dice, tests/examples/full_field/gold/DICe_solution_0.txt."""
    path = tmp_path / "a.txt"
    names = "COORDINATE_X,COORDINATE_Y,DISPLACEMENT_X,DISPLACEMENT_Y,SIGMA,GAMMA,BETA\n"
    path.write_text(DICE + names + rows(np.ones((40, 7))))
    with pytest.raises(InputError, match="separate_output_file_for_each_subset"):
        read_table(path, 250.0)


@pytest.mark.parametrize("individuals", ["", "individuals" + 6 * ",beam" + "\n"], ids=["one", "several"])
def test_deeplabcut_as_movement_writes_it(tmp_path, individuals):
    """to_dlc_file in neuroinformatics-unit/movement, movement/io/save_poses.py: levels of the header, rows by frame."""
    head = f"scorer{6 * ',movement'}\n{individuals}bodyparts,tip,tip,tip,mid,mid,mid\n"
    head += "coords,x,y,likelihood,x,y,likelihood\n"
    values = [np.arange(40), MOTION, np.full(40, 0.9), 2.0 * MOTION, np.full(40, 0.8)]
    before = "beam " if individuals else ""
    names = [f"{before}{part} {axis}" for part in ("tip", "mid") for axis in "xy"]
    text = head + rows(*values, number="{:.10g}".format)
    assert_read(tmp_path / "a.csv", text, names, 250.0, np.column_stack([MOTION, 2.0 * MOTION]))
    for wrong, words in (("coords", "expected scorer"), ("mid", "two columns of one name")):
        (tmp_path / "b.csv").write_text(text.replace(wrong, "tip"))
        with pytest.raises(InputError, match=words):
            read_table(tmp_path / "b.csv", 250.0)


def test_identify_reads_a_file_of_tracker(tmp_path, modalcam, in_process):
    time_s = np.arange(300) / 250.0
    noise = 0.01 * np.random.default_rng(2).standard_normal(time_s.size)
    table = rows(time_s, decay(time_s, 12.0, 0.01) + noise, separator="\t", number=scientific)
    (tmp_path / "a.txt").write_text("mass_A\nt\tx\n" + table)
    code, _, _ = modalcam("identify", tmp_path / "a.txt", "-o", tmp_path / "out")
    assert code == ExitCode.OK
    (found,) = pd.read_csv(tmp_path / "out" / "modes.csv").to_dict("records")
    error_hz = abs(found["frequency_hz"] - 12.0)
    assert error_hz < 4.0 * found["frequency_sd_hz"] < 0.05, "four standard deviations, much less than a mode"
