"""How much of a declared recording was decoded, in words; series as signals of SEP 005, by the standard's validator."""

import numpy as np
import pytest
from kit.series import series_of

import modalcam as mc
from tracker import DecodeReport, DisplacementSeries


def report(declared, decoded, corrupt=0):
    return DecodeReport("mjpeg", "gray", 64, 48, 8, declared, decoded, corrupt, lossy=True)


def test_a_cut_file_states_frames_and_times():
    assert report(1301, 137, corrupt=1).cut_off(500.0) == (
        "the file is cut off: 138 of the 1301 frames that it declares could be read, 0.276 s of 2.602 s"
    )


def test_without_a_rate_there_are_no_times():
    assert report(1301, 138).cut_off(None).endswith("138 of the 1301 frames that it declares could be read")


@pytest.mark.parametrize(
    ("declared", "decoded", "corrupt"),
    [(0, 138, 0), (138, 138, 0), (138, 100, 38), (100, 138, 0), (20, 18, 0), (1000, 990, 0)],
    ids=["not declared", "complete", "damaged frames", "more than declared", "two of 20", "1 %"],
)
def test_a_file_that_misses_nothing_worth_mentioning_is_not_cut_off(declared, decoded, corrupt):
    assert report(declared, decoded, corrupt).cut_off(500.0) == ""


TIME_S = 0.2 + np.arange(40) / 250.0
MOTION = np.random.default_rng(4).standard_normal((40, 2))
SIGNAL = {"name": "tip", "data": MOTION[:, 0], "unit_str": "mm", "fs": 250.0}


@pytest.mark.parametrize("uneven", [False, True])
def test_signals_are_valid_and_give_the_series_back(uneven):
    validator = pytest.importorskip("sdypy_sep005.sep005", reason="sdypy-sep005 is not installed")
    values, times = MOTION.copy(), TIME_S.copy()
    values[5, 1] = np.nan
    times[7] += 1e-3 * uneven
    sd = np.array([0.1, np.nan])
    series = series_of(times, values, "mm", sd=sd)
    signals = series.to_sep005()
    validator.assert_sep005(signals)
    assert [signal.get("fs") for signal in signals] == 2 * [
        None if uneven else pytest.approx(250.0, rel=1e-12)
    ]
    assert ["sd" in signal for signal in signals] == [True, False]
    again = DisplacementSeries.from_sep005(signals)
    assert (again.channels, again.unit) == (series.channels, "mm")
    for name in ("time_s", "values", "sd"):
        np.testing.assert_array_equal(getattr(again, name), getattr(series, name))


def test_signals_of_others_are_read():
    """A list with None for a missing sample, a rate and no times, and a name that occurs twice."""
    validator = pytest.importorskip("sdypy_sep005.sep005", reason="sdypy-sep005 is not installed")
    listed = SIGNAL | {"data": [None, *MOTION[1:, 1].tolist()], "quantity": "d", "group": "b"}
    validator.assert_sep005([SIGNAL, listed])
    series = DisplacementSeries.from_sep005([SIGNAL, listed])
    assert series.channels == ("tip 1", "tip 2")
    np.testing.assert_allclose(series.time_s, np.arange(40) / 250.0, rtol=1e-15)
    np.testing.assert_array_equal(series.values[1:], MOTION[1:])
    assert np.isnan(series.values[0, 1])


@pytest.mark.parametrize(
    ("signals", "words"),
    [
        ([{"name": "a", "data": [1.0]}], "signal 1 of 1 has no unit_str, no time or fs"),
        ([], "one unit, found no signal"),
        ([SIGNAL, SIGNAL | {"unit_str": "g"}], "one unit, found g, mm"),
        ([SIGNAL, SIGNAL | {"fs": 100.0}], "the same times"),
        ([SIGNAL, SIGNAL | {"data": MOTION[:9, 0]}], "the same times"),
        ([SIGNAL, SIGNAL | {"start_timestamp": "2026-01-01T00:00:00"}], "the same times"),
        ([SIGNAL | {"data": MOTION}], "the same times"),
        ([SIGNAL | {"time": np.zeros(40)}], "strictly increasing"),
    ],
    ids=["fields", "none", "units", "rates", "lengths", "starts", "matrix", "times"],
)
def test_signals_that_are_no_series_are_refused(signals, words):
    with pytest.raises(ValueError, match=words):
        DisplacementSeries.from_sep005(signals)


def test_identify_takes_signals_but_no_values_beside_them():
    with pytest.raises(ValueError, match="found a series and values"):
        mc.identify([SIGNAL], MOTION)
    with pytest.raises(ValueError, match="positions_mm must have shape"):
        mc.identify(SIGNAL, positions_mm=[1.0, 2.0])
