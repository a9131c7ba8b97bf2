"""Tables as other programs write them: the same times and channels from every format, and what was assumed is said."""

import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat
from support.memory import peak_of

from modalcam.common import InputError
from modalcam.inputs import checked_unit, read_table, register_table_reader, series_from_table

TIME_S = np.arange(40) / 250.0
MOTION = np.round(np.random.default_rng(4).standard_normal((40, 2)), 6)


def rows(separator, decimal="."):
    table = np.column_stack([TIME_S, MOTION])
    return "\n".join(separator.join(f"{value:.6f}".replace(".", decimal) for value in row) for row in table)


def lvm(times):
    head = "LabVIEW Measurement\t\nWriter_Version\t2\nSeparator\tTab\nDecimal_Separator\t,\nX_Columns\t{}\n"
    kind = "One" if times else "No"
    second = (
        "***End_of_Header***\t\n\nChannels\t2\nX_Dimension\tTime\tTime\nX0\t0,0\t0,0\nDelta_X\t0,004\t0,004\n"
    )
    body = (
        rows("\t", ",")
        if times
        else "\n".join("\t" + line.split("\t", 1)[1] for line in rows("\t", ",").split("\n"))
    )
    return head.format(kind) + second + "***End_of_Header***\t\t\nX_Value\ta\tb\tComment\n" + body


TEXTS = {
    "plain.csv": "time_s,a,b\n" + rows(","),
    "header in a comment.csv": "# time_s,a,b\n" + rows(","),
    "byte order mark.csv": "\ufefftime_s,a,b\n" + rows(","),
    "German.csv": "Zeit [s];a;b\n" + rows(";", ","),
    "tabs.txt": "Time (s)\ta\tb\n" + rows("\t"),
    "blanks.dat": "t a b\n" + rows("  "),
    "preamble.csv": "Instrument: X, Y\nSerial 123\n\nTime/s,a,b\n" + rows(","),
    "signs that end no line.csv": "Serial\x0c1\x85\u20282\nTime/s,a,b\n" + rows(","),
    "a comma at the end of rows.csv": "time_s,a,b\n" + rows(",").replace("\n", ",\n") + ",",
    "no names.csv": rows(","),
    "one column of times.lvm": lvm(times=True),
    "no times.lvm": lvm(times=False),
}


@pytest.mark.parametrize("name", TEXTS)
def test_every_text_gives_the_same_table(tmp_path, name):
    path = tmp_path / name
    path.write_text(TEXTS[name], "utf-8")
    table = read_table(path)
    assert table.columns.shape == (40, 3)
    np.testing.assert_allclose(table.columns["time_s"], TIME_S, atol=1e-12)
    np.testing.assert_array_equal(table.columns.to_numpy()[:, 1:], MOTION)
    assert (table.notes == ()) == ("time_s" in TEXTS[name])


def test_utf_16_and_milliseconds(tmp_path):
    path = tmp_path / "a.txt"
    text = "time_ms\ta\n" + "\n".join(f"{1e3 * t:g}\t{v}" for t, v in zip(TIME_S, MOTION[:, 0], strict=True))
    path.write_text(text, "utf-16")
    table = read_table(path)
    np.testing.assert_allclose(table.columns["time_s"], TIME_S, rtol=1e-12)
    assert "0.001 s" in table.notes[-1]


def test_units_below_the_names_and_uneven_times_without_a_name(tmp_path):
    numbers = "\n".join(f"{1e3 * t:.9g},{v:.9g}" for t, v in zip(TIME_S, MOTION[:, 0], strict=True))
    (tmp_path / "a.csv").write_text(f"Time,Channel A\n(ms),(V)\n\n{numbers}\n")
    columns = read_table(tmp_path / "a.csv").columns
    assert list(columns) == ["time_s", "Channel A [V]"]
    np.testing.assert_allclose(columns["time_s"], TIME_S, rtol=1e-8)
    uneven = TIME_S + 0.9e-3 * np.sin(np.arange(TIME_S.size))
    np.save(tmp_path / "b.npy", np.column_stack([uneven, MOTION[:, 0]]))
    np.testing.assert_array_equal(read_table(tmp_path / "b.npy").columns["time_s"], uneven)
    with pytest.raises(InputError, match="--rate is for tables without times"):
        read_table(tmp_path / "b.npy", 250.0)


@pytest.mark.parametrize(
    ("names", "unit"),
    [
        ("a [g],b [g]", "g"),
        ("Acc X (m/s^2),Acc Y (m/s^2)", "m/s^2"),
        ("a (mm),sd_a (mm)", "mm"),
        ("a [g],b [N]", ""),
        ("a [g],b", ""),
        ("a (left),b (left)", ""),
        ("a [banana],b [banana]", ""),
    ],
)
def test_a_unit_in_the_names_of_all_channels_is_that_of_the_table(tmp_path, names, unit):
    rows = "\n".join(f"{t:.9g},1,2" for t in TIME_S)
    (tmp_path / "a.csv").write_text(f"Time (s),{names}\n{rows}\n")
    assert read_table(tmp_path / "a.csv").unit == unit


@pytest.mark.parametrize(
    "unit", ["mm", "um/s", "m/s2", "m/s²", "m/s^2", "V", "N·m", "rad", "°", "1", "%", "counts"]
)
def test_units_are_products_of_powers_of_known_ones(unit):
    assert checked_unit(unit, "--unit") == unit
    for wrong in (f"{unit}x", f"{unit}//s", "", "banana"):
        with pytest.raises(InputError, match="--unit: expected a unit such as mm"):
            checked_unit(wrong, "--unit")


@pytest.mark.parametrize("order", ["samples by channels", "channels by samples"])
def test_numpy_arrays(tmp_path, order):
    array = np.column_stack([TIME_S, MOTION])
    np.save(tmp_path / "a.npy", array if order == "samples by channels" else array.T)
    columns = read_table(tmp_path / "a.npy").columns
    np.testing.assert_array_equal(columns.to_numpy(), array)
    np.save(tmp_path / "b.npy", MOTION[:, 0])
    columns = read_table(tmp_path / "b.npy", 250.0).columns
    np.testing.assert_array_equal(columns.to_numpy(), array[:, :2])
    with pytest.raises(InputError, match="give --rate"):
        read_table(tmp_path / "b.npy")


@pytest.mark.parametrize("order", ["samples by channels", "channels by samples"])
@pytest.mark.parametrize("ending", [".npy", ".mat", ".csv"])
@pytest.mark.parametrize("timed", [True, False], ids=["times first", "without times"])
def test_the_longer_axis_of_an_array_without_names_is_time(tmp_path, order, ending, timed):
    array = np.column_stack([TIME_S, MOTION]) if timed else MOTION
    stored = array if order == "samples by channels" else array.T
    path = tmp_path / f"a{ending}"
    if ending == ".npy":
        np.save(path, stored)
    elif ending == ".mat":
        savemat(path, {"data": stored})
    else:
        np.savetxt(path, stored, delimiter=",", fmt="%.17g")
    table = read_table(path, None if timed else 250.0)
    np.testing.assert_allclose(table.columns["time_s"], TIME_S, rtol=1e-12)
    np.testing.assert_array_equal(table.columns.to_numpy()[:, 1:], MOTION)
    assert order == "samples by channels" or any("the longer axis is time" in note for note in table.notes)


@pytest.mark.parametrize("order", ["along the beam", "any"])
@pytest.mark.parametrize("transposed", [False, True])
def test_of_many_channels_and_samples_the_axis_that_oscillates_is_time(tmp_path, order, transposed):
    """300 channels of a field and 200 samples of 14 cycles: the longer axis is not time."""
    rng = np.random.default_rng(4)
    t, x = np.arange(200) / 250.0, np.linspace(0.0, 1.0, 300)
    field = np.outer(np.exp(-0.3 * t) * np.cos(2.0 * np.pi * 17.3 * t), np.sin(4.6 * x))
    field = field[:, rng.permutation(300)] if order == "any" else field
    field = field + 0.02 * rng.standard_normal(field.shape)
    np.save(tmp_path / "a.npy", field.T if transposed else field)
    table = read_table(tmp_path / "a.npy", 250.0)
    np.testing.assert_array_equal(table.columns.to_numpy()[:, 1:], field)
    assert any(f"the {'second' if transposed else 'first'} axis is time" in note for note in table.notes)


def test_many_channels_and_samples_that_show_no_axis_of_time_are_refused(tmp_path):
    np.save(tmp_path / "a.npy", np.random.default_rng(1).standard_normal((200, 300)))
    with pytest.raises(InputError, match="either axis may be time; add the times as the first column"):
        read_table(tmp_path / "a.npy", 250.0)


def test_rows_of_channels_without_times_say_which_axis_was_taken_for_time(tmp_path):
    np.save(tmp_path / "a.npy", MOTION.T)
    words = r"give --rate if it has no times \(The array .* the longer axis is time\)"
    with pytest.raises(InputError, match=words):
        read_table(tmp_path / "a.npy")


@pytest.mark.parametrize(
    "cell", ["y", "0.5"], ids=["names of channels in the first column", "times as a header"]
)
def test_a_table_with_a_row_for_each_channel_is_asked_whether_it_is_transposed(tmp_path, cell):
    rows = [["time_s", *TIME_S], *([cell, *channel] for channel in MOTION.T)]
    path = tmp_path / "a.csv"
    path.write_text("\n".join(",".join(map(str, row)) for row in rows))
    words = r"transposed. Write a row for each time and a column for each channel"
    with pytest.raises(InputError, match=words):
        series_from_table(read_table(path), name="a", unit="mm")


@pytest.mark.parametrize("clock", [{"t": TIME_S}, {"fs": 250.0}])
def test_matlab_files(tmp_path, clock):
    savemat(tmp_path / "a.mat", {"y": MOTION, "name": "beam", **clock})
    columns = read_table(tmp_path / "a.mat").columns
    assert list(columns) == ["time_s", "y 1", "y 2"]
    np.testing.assert_array_equal(columns.to_numpy(), np.column_stack([TIME_S, MOTION]))


def test_a_rate_counts_samples_and_frames(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("frame,x\n" + "\n".join(f"{2 * k},{v}" for k, v in enumerate(MOTION[:, 0])))
    table = read_table(path, 500.0)
    np.testing.assert_allclose(table.columns["time_s"], TIME_S, rtol=1e-12)
    assert list(table.columns) == ["time_s", "x"]
    assert "column frame counts samples at 500 per second" in table.notes[0]


def test_a_matlab_structure_is_not_read_into_memory(tmp_path):
    path, zeros = tmp_path / "a.mat", np.zeros(3_000_000)
    savemat(path, {"time_s": TIME_S, "s": {"zeros": zeros}, "a": MOTION[:, 0]})
    peak_bytes, table = peak_of(lambda: read_table(path).columns)
    np.testing.assert_array_equal(table["a"], MOTION[:, 0])
    assert peak_bytes < 0.2 * zeros.nbytes, "NumPy counts arrays: those of the structure are not among them"


def test_settings_of_a_labview_measurement_without_values_are_those_of_a_usual_one(tmp_path):
    text = lvm(times=True).replace("Separator\t,", "Separator").replace("One", "").replace(",", ".")
    (tmp_path / "a.lvm").write_text(text)
    np.testing.assert_array_equal(read_table(tmp_path / "a.lvm").columns.to_numpy()[:, 1:], MOTION)


def test_a_reader_is_registered_once_for_an_ending(monkeypatch, tmp_path):
    monkeypatch.setattr("modalcam.inputs.table_readers.TABLE_READERS", readers := {})
    monkeypatch.setattr("modalcam.inputs.table.TABLE_READERS", readers)

    def read(path):
        return pd.read_csv(path), [path.name]

    for _ in range(2):
        register_table_reader(".log", read)
    (tmp_path / "a.LOG").write_text("time_s,a\n0,1\n")
    assert read_table(tmp_path / "a.LOG").notes == ("a.LOG",)
    for taken in (".log", ".uff"):
        with pytest.raises(ValueError, match="have a reader already"):
            register_table_reader(taken, pd.read_csv)


def npy_header(expression):
    """A NumPy array with any header, which NumPy parses as an expression in Python."""
    return b"\x93NUMPY\x01\x00" + len(expression).to_bytes(2, "little") + expression.encode()


@pytest.mark.parametrize(
    ("name", "content", "rate", "words"),
    [
        ("a.csv", b"time_s,a\n0,1\n1,2\n", 10.0, "--rate is for tables without times"),
        ("a.csv", b"t,time,a\n0,0,1\n1,1,2\n", None, "one column of times, found t, time"),
        ("a.csv", b"a,b\n3,1\n1,2\n", None, "give --rate"),
        ("a.npy", b"no array", None, "expected a table"),
        ("a.npy", b"", None, "expected a table"),
        (
            "a.npy",
            b"\x93NUMPY\x01\x00v\x00{'descr': '<f8', 'fortran_order': False, 'shape': (99999999999,), }",
            9.0,
            "expected",
        ),
        (
            "a.npy",
            b"\x93NUMPY\x01\x00v\x00{'descr': '|O', 'fortran_order': False, 'shape': (3,), }" + b" " * 60,
            9.0,
            "expected",
        ),
        ("a.npy", npy_header("{'descr': '<f8', ("), 9.0, "EOF in multi-line statement"),
        ("a.npy", npy_header("{[]: 1}"), 9.0, "unhashable"),
        ("a.mat", b"no MATLAB file" * 30, None, "expected a table"),
        ("a.mat", b"\x89HDF\r\n\x1a\n" * 30, None, "expected a table"),
        ("a.lvm", b"LabVIEW Measurement\n", None, "two headers"),
        ("a.lvm", lvm(times=True).partition("X_Value")[0].encode(), None, "no row of numbers"),
        ("a.lvm", lvm(times=True).replace("X_Value\ta\tb", "\t\t").encode(), None, "no row of numbers"),
        ("a.lvm", lvm(times=True).replace("\tTab", ",Comma").replace("\t", ",").encode(), None, "with tabs"),
        ("a.lvm", lvm(times=True).replace("0,016000", "0,0x6").encode(), None, "Unable to parse string"),
        (
            "a.npz",
            b"PK\x03\x04\x80\xa6\xff",
            None,
            r"one of \.npy, .*\.uff.* Export the series as CSV in UTF-8",
        ),
        ("a.csv", "time_s,a µm\n0,1\n".encode("latin-1"), None, "expected text in UTF-8"),
        ("a.csv", b"time_s,a\n" + rows(",").encode(), None, "more cells than the header"),
    ],
)
def test_what_is_no_table_is_refused(tmp_path, name, content, rate, words):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=words):
        read_table(tmp_path / name, rate)
