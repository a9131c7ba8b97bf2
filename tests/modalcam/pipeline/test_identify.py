"""What the stage of the identification adds: markers that nobody chose, a rolling shutter, the exposure."""

import numpy as np
import pytest
from kit import runs
from kit.series import QUICK, series_of

from modal_id import IdentifySettings
from modalcam.pipeline import ImageRows, correct_amplitudes, identify_series


def test_a_failure_names_markers_that_nobody_chose():
    time_s = np.arange(500) / 250.0
    still = series_of(time_s, np.random.default_rng(1).standard_normal((500, 3)))
    settings = IdentifySettings(seed=1)
    chosen = identify_series(still, settings, None)
    assert not chosen
    assert "pick" not in chosen.reason, "the markers were named in the configuration"
    detected = identify_series(still, settings, None, "3 dots")
    assert detected.reason.startswith(chosen.reason)
    assert "3 dots were detected without a kind of marker being given" in detected.reason
    assert "modalcam pick" in detected.reason


def test_the_note_is_that_of_rows_whose_readout_is_not_given():
    rows, time_s = np.linspace(10.0, 210.0, 8), np.arange(160) / 200.0
    turns = 2.0 * np.pi * 9.0 * (time_s[:, None] + 2e-5 * rows)
    noise = 0.01 * np.random.default_rng(3).normal(size=turns.shape)
    series = series_of(time_s, np.linspace(0.3, 1.0, 8) * np.exp(-0.01 * turns) * np.cos(turns) + noise)
    settings = IdentifySettings(onset_s=0.0, sampler=QUICK, seed=1)
    told, silent = (
        [note for note in identify_series(series, settings, None, rows=given).notes if "readout_s" in note]
        for given in (ImageRows(rows, 241), None)
    )
    assert silent == []
    # 20 us for each of 240 steps between rows.
    assert abs(float(told[0].split("readout_s = ")[1].split()[0]) / 4.8e-3 - 1.0) < 0.1


def test_the_amplitude_is_corrected_and_the_shape_is_not():
    found = runs.recording(0, frequency_hz=88.6, number=5, seconds=1.0).identification
    corrected = correct_amplitudes(found, 1e-3)
    before, after = found.modes[0], corrected.modes[0]
    x = np.pi * before.frequency_hz * 1e-3
    assert after.amplitude == pytest.approx(before.amplitude * x / np.sin(x))
    assert np.array_equal(after.shape, before.shape)
    assert "corrected by 1.3 %" in after.notes[-1]


def test_no_note_without_an_exposure_time_or_attenuation():
    found = runs.recording(0, frequency_hz=2.0, seconds=1.0).identification
    assert correct_amplitudes(found, None) is found
    assert correct_amplitudes(found, 0.0) is found
    assert correct_amplitudes(found, 1e-4).modes[0].notes == found.modes[0].notes


def test_an_exposure_of_about_a_period_is_not_corrected():
    found = runs.recording(0, frequency_hz=88.6, number=5, seconds=1.0).identification
    long = correct_amplitudes(found, 0.01).modes[0]
    assert long.amplitude == found.modes[0].amplitude
    assert "0.89 periods" in long.notes[-1]
