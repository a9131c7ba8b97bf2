"""Files in TDMS and HDF5 (NetCDF, MATLAB 7.3, movement) written by other libraries: the same times and channels."""

import sys

import numpy as np
import pandas as pd
import pytest

from modalcam.common import InputError
from modalcam.config import RecordingConfig
from modalcam.inputs import motion_of, read_table
from modalcam.pipeline import Limits

TIME_S = np.arange(40) / 250.0
MOTION = np.round(np.random.default_rng(4).standard_normal((40, 2)), 6)
CLOCK = {"wf_increment": 0.004, "wf_start_offset": 0.0}


def assert_read(path, names, time_s=TIME_S, rate_hz=None):
    """The table of `MOTION`; times are equal but for the rounding of a sum."""
    columns = read_table(path, rate_hz).columns
    assert list(columns) == ["time_s", *names]
    np.testing.assert_allclose(columns["time_s"], time_s, rtol=1e-12, atol=1e-15)
    np.testing.assert_array_equal(columns.to_numpy()[:, 1:], MOTION)


def write_tdms(path, *channels):
    """Channels as (group, name, values, properties)."""
    nptdms = pytest.importorskip("nptdms", reason="the extra modalcam[tdms] is not installed")
    with nptdms.TdmsWriter(path) as file:
        file.write_segment([nptdms.ChannelObject(*channel) for channel in channels])
    return path


def pair(properties=None, groups=("take", "take"), names=("a", "b")):
    return [(g, n, y, properties or {}) for g, n, y in zip(groups, names, MOTION.T, strict=True)]


def test_waveforms_of_a_tdms_file_have_the_times_of_their_increment(tmp_path):
    path = write_tdms(tmp_path / "a.tdms", *pair(CLOCK | {"wf_start_offset": 0.1}))
    assert_read(path, ["a", "b"], TIME_S + 0.1)
    assert "250 samples per second, as the file says" in read_table(path).notes[1]


def test_times_of_a_tdms_file_may_be_a_channel_or_time_stamps(tmp_path):
    in_ms = ("take", "Time (ms)", 1e3 * TIME_S, {})
    assert_read(write_tdms(tmp_path / "a.tdms", in_ms, *pair()), ["a", "b"])
    stamps = np.datetime64("2026-01-01T00:00:00") + (1e6 * TIME_S).astype("timedelta64[us]")
    assert_read(write_tdms(tmp_path / "b.tdms", ("take", "at", stamps, {}), *pair()), ["a", "b"])
    assert_read(write_tdms(tmp_path / "c.tdms", *pair()), ["a", "b"], rate_hz=250.0)


@pytest.mark.parametrize("units", [("g", "g"), ("g", "N"), ("", "")], ids=["one", "two", "none"])
@pytest.mark.parametrize("ending", ["tdms", "h5"])
def test_the_unit_that_all_channels_state_is_that_of_the_series(tmp_path, hdf5, in_process, ending, units):
    path = tmp_path / f"a.{ending}"
    if ending == "tdms":
        given = zip(pair(), units, strict=True)
        write_tdms(path, *[(g, n, y, CLOCK | {"unit_string": u}) for (g, n, y, _), u in given])
    else:
        with hdf5.File(write_hdf5(path, hdf5, {"fs": 250.0}, a=MOTION[:, 0], b=MOTION[:, 1]), "a") as file:
            for name, unit in zip("ab", units, strict=True):
                file[name].attrs["units"] = unit
    motion = motion_of(path, "a", RecordingConfig(file=path.name), Limits(), unit="mm", rate_hz=None)
    assert motion["series"].unit == ("g" if units == ("g", "g") else "mm")
    assert any("--unit mm was not used" in note for note in motion["series"].notes) == (units == ("g", "g"))
    assert any("state N, g as their units" in note for note in motion["series"].notes) == ("N" in units)


def test_of_a_tdms_file_the_longest_channels_of_numbers_are_read(tmp_path):
    short, text = ("slow", "temperature", np.ones(4), {}), ("take", "remark", ["x"] * 40, {})
    path = write_tdms(tmp_path / "a.tdms", short, text, *pair(CLOCK, ("left", "right"), ("y", "y")))
    assert_read(path, ["left y", "right y"])
    assert "2 of 3 channels" in read_table(path).notes[0]


def test_a_tdms_file_that_was_cut_is_read_to_its_end_and_says_so(tmp_path, capfd):
    path = write_tdms(tmp_path / "a.tdms", ("take", "a", MOTION[:, 0], CLOCK))
    path.write_bytes(path.read_bytes()[:-80])
    table = read_table(path)
    # eight bytes a value
    np.testing.assert_array_equal(table.columns["a"], MOTION[:-10, 0])
    assert any("less data than expected" in note for note in table.notes)
    assert capfd.readouterr() == ("", ""), "nptdms prints what it doubts"


@pytest.mark.parametrize(
    ("channels", "words"),
    [
        ([("take", "remark", ["x"] * 40, {})], "numeric channels none"),
        (
            [("take", "a", MOTION[:, 0], CLOCK), ("take", "b", MOTION[:, 1], {"wf_increment": 0.01})],
            "one positive",
        ),
        ([*pair(CLOCK)[:1], ("take", "b", MOTION[:, 1], CLOCK | {"wf_start_offset": 1.0})], "of one start"),
        ([("take", "a", MOTION[:, 0], {"wf_increment": "a"})], "could not convert"),
    ],
    ids=["texts", "rates", "starts", "increment"],
)
def test_other_tdms_files_are_refused(tmp_path, channels, words):
    with pytest.raises(InputError, match=words):
        read_table(write_tdms(tmp_path / "a.tdms", *channels))


@pytest.fixture
def hdf5():
    return pytest.importorskip("h5py", reason="the extra modalcam[netcdf] is not installed")


def write_hdf5(path, hdf5, attributes=None, **datasets):
    with hdf5.File(path, "w") as file:
        for name, values in datasets.items():
            file[name.replace("__", "/")] = values
        file.attrs.update(attributes or {})
    return path


@pytest.mark.parametrize("order", ["samples by channels", "channels by samples"])
@pytest.mark.parametrize("clock", [{"time": TIME_S}, {"acquisition__fs": 250.0}])
def test_datasets_of_hdf5(tmp_path, hdf5, order, clock):
    stored = MOTION if order == "samples by channels" else MOTION.T
    others = {"name": "beam", "temperature": np.ones(3), "pole": np.ones(40) * 1j}
    assert_read(write_hdf5(tmp_path / "a.h5", hdf5, None, run__y=stored, **clock, **others), ["y 1", "y 2"])


def test_a_rate_may_be_an_attribute_and_names_are_unique(tmp_path, hdf5):
    groups = {"left__y": MOTION[:, 0], "right__y": MOTION[:, 1]}
    assert_read(write_hdf5(tmp_path / "a.hdf5", hdf5, {"fs": 250}, **groups), ["left/y", "right/y"])
    assert_read(write_hdf5(tmp_path / "b.h5", hdf5, None, **groups), ["left/y", "right/y"], rate_hz=250.0)


def test_a_dataset_of_times_has_the_unit_of_its_attribute(tmp_path, hdf5):
    path = write_hdf5(tmp_path / "a.h5", hdf5, None, Time=1e3 * TIME_S, y=MOTION)
    with hdf5.File(path, "a") as file:
        file["Time"].attrs["units"] = np.bytes_("ms")
    assert_read(path, ["y 1", "y 2"])


@pytest.mark.parametrize(
    ("attributes", "datasets", "words"),
    [
        (None, {"name": "beam"}, "0 numbers"),
        ({"fs": 250.0, "rate": 100.0}, {"y": MOTION}, "100, 250; state one positive"),
        ({"fs": -1.0}, {"y": MOTION}, "-1; state one positive"),
        (None, {"time": TIME_S, "y": np.ones((40, 40))}, "any axis .* may be time"),
        (None, {"y": MOTION}, "give --rate"),
    ],
    ids=["no numbers", "two rates", "rate", "axes", "no times"],
)
def test_other_files_in_hdf5_are_refused(tmp_path, hdf5, attributes, datasets, words):
    with pytest.raises(InputError, match=words):
        read_table(write_hdf5(tmp_path / "a.h5", hdf5, attributes, **datasets))


def test_values_in_other_files_are_not_read(tmp_path, hdf5):
    """A file of others must not show what it cannot contain."""
    secret = write_hdf5(tmp_path / "secret.h5", hdf5, None, s=MOTION[:, 0])
    path = write_hdf5(tmp_path / "a.h5", hdf5, None, time=TIME_S, y=MOTION)
    with hdf5.File(path, "a") as file:
        file["linked"] = hdf5.ExternalLink("secret.h5", "s")
        file.create_dataset("raw", (40,), "f8", external=[(str(secret), 0, 320)])
        layout = hdf5.VirtualLayout((40,), "f8")
        layout[:] = hdf5.VirtualSource(str(secret), "s", (40,))
        file.create_virtual_dataset("virtual", layout)
        file.create_dataset("rate", (1,), "f8", external=[(str(secret), 0, 8)])
    assert_read(path, ["y 1", "y 2"])
    with hdf5.File(path, "a") as file:
        del file["time"]
    assert_read(path, ["y 1", "y 2"], rate_hz=250.0)


@pytest.mark.parametrize("stored", ["numbers", "durations", "dates"])
def test_netcdf_of_xarray(tmp_path, stored):
    """Times as xarray encodes them, a packed channel (CF conventions 8.1) with a missing sample (2.5.1)."""
    xr = pytest.importorskip("xarray", reason="xarray is not installed")
    since = pd.to_timedelta(TIME_S, unit="s")
    times = {"numbers": TIME_S, "durations": since, "dates": pd.Timestamp("2026-01-01") + since}[stored]
    holed = MOTION.copy()
    holed[7, 1] = np.nan
    coords = {"time": times, "channel": ["tip", "\u03b6"]}
    data = xr.Dataset({"y": (("channel", "time"), holed.T)}, coords=coords)
    packed = {"y": {"dtype": "i4", "scale_factor": 1e-6, "add_offset": 1.0, "_FillValue": -(2**31)}}
    data.to_netcdf(tmp_path / "a.nc", engine="h5netcdf", encoding=packed)
    columns = read_table(tmp_path / "a.nc").columns
    assert list(columns) == ["time_s", "y tip", "y \u03b6"]
    np.testing.assert_allclose(columns["time_s"], TIME_S, atol=1e-9, err_msg="xarray counts nanoseconds")
    np.testing.assert_allclose(
        columns.to_numpy()[:, 1:], holed, atol=1e-14, err_msg="a few roundings of numbers of 1 to 4"
    )


@pytest.mark.parametrize("fps", [250.0, None])
def test_netcdf_of_movement(tmp_path, fps):
    """https://movement.neuroinformatics.dev/user_guide/movement_dataset.html: dimensions, coordinates, attributes.

    Without ``fps`` the coordinate ``time`` counts frames.
    """
    xr = pytest.importorskip("xarray", reason="xarray is not installed")
    dims = ("time", "space", "keypoints", "individuals")
    position, confidence = MOTION[:, :, None, None], np.full((40, 1, 1), 0.9)
    values = {"position": (dims, position), "confidence": (("time", *dims[2:]), confidence)}
    coords = {"time": TIME_S if fps else np.arange(40), "space": ["x", "y"], "keypoints": ["tip"]}
    about = {"source_software": "DeepLabCut", "ds_type": "poses"}
    about |= {"time_unit": "seconds", "fps": fps} if fps else {"time_unit": "frames"}
    data = xr.Dataset(values, coords=coords | {"individuals": ["beam"]}, attrs=about)
    data.to_netcdf(tmp_path / "a.nc", engine="h5netcdf")
    assert_read(tmp_path / "a.nc", ["position x", "position y"], rate_hz=None if fps else 250.0)


def test_matlab_7_3(tmp_path, hdf5):
    """https://www.mathworks.com/help/matlab/import_export/mat-file-versions.html: HDF5 behind a header of MATLAB.

    An array of MATLAB is stored with its axes reversed, a number as an array of 1 by 1, text as numbers.
    """
    path = tmp_path / "a.mat"
    with hdf5.File(path, "w", userblock_size=512) as file:
        for name, values, kind in (
            ("y", MOTION.T, "double"),
            ("Fs", np.array([[250.0]]), "double"),
            ("remark", np.full((40, 1), 65, np.uint16), "char"),
        ):
            file.create_dataset(name, data=values).attrs["MATLAB_class"] = np.bytes_(kind)
        file["#refs#/a"] = MOTION
    head = b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM"
    path.write_bytes(head + path.read_bytes()[128:])
    assert_read(path, ["y 1", "y 2"])


@pytest.mark.parametrize(("library", "ending"), [("nptdms", "tdms"), ("h5py", "nc")])
def test_a_missing_library_is_named(tmp_path, monkeypatch, library, ending):
    monkeypatch.setitem(sys.modules, library, None)
    (tmp_path / f"a.{ending}").write_bytes(b"")
    with pytest.raises(InputError, match=f"needs {library}; install it with pip install {library}"):
        read_table(tmp_path / f"a.{ending}")
