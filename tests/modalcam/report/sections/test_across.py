"""Modes across recordings and checks of the fit, as the report tells them."""

from dataclasses import replace

import numpy as np
import pytest
from support.sim_decays import identification

from modalcam.pipeline.measured import measured_modes
from modalcam.pipeline.results import RecordingResult, RunResult
from modalcam.report.derived.signals import instantaneous
from modalcam.report.sections.across import across_rows
from modalcam.report.sections.checks import check_rows

TIME_S = np.arange(3000) / 500.0
POSITIONS_MM = np.array([100.0, 250.0, 400.0, 490.0])
SHAPE = np.array([0.1, -0.6, -0.2, 1.0])


def recording(name, frequency_hz, damping_ratio, shape=SHAPE):
    found = identification(
        [(frequency_hz, damping_ratio, shape, 3)], time_s=TIME_S, positions_mm=POSITIONS_MM, fit_from_s=0.0
    )
    rng = np.random.default_rng(8)
    noisy = found.series.values + 1e-3 * rng.standard_normal(found.series.values.shape)
    found = replace(found, series=replace(found.series, values=noisy))
    return RecordingResult(name, name, "", 3, identification=found)


def result(*recordings):
    return RunResult("folder", recordings, None, (), "", (), "modalcam run folder", 0)


def test_recordings_that_agree():
    (row,) = across_rows(result(recording("a", 26.84, 0.0028), recording("b", 26.8401, 0.00281)))
    assert row.agrees
    assert "agree" in row.text
    assert row.recordings == ("a", "b")
    assert row.least_mac == "1.0000"


def test_recordings_that_disagree_are_told_and_widened():
    # Standard deviations are 1e-5 of the frequency and half a percent of the damping ratio.
    pair = result(recording("a", 26.84, 0.0028), recording("b", 26.90, 0.0032))
    (row,) = across_rows(pair)
    assert not row.agrees
    assert "frequencies differ by more than chance" in row.text
    assert "damping ratios differ by more than chance" in row.text
    (mode,) = measured_modes(pair.recordings)
    assert mode.frequency_sd_hz == pytest.approx(0.03, rel=1e-3), (
        "half the distance of two equally good values"
    )
    assert mode.damping_ratio_sd == pytest.approx(0.0002, rel=0.02)


def test_one_recording_is_no_comparison():
    assert across_rows(result(recording("a", 26.84, 0.0028))) == ()


def test_checks_of_a_fit_that_holds_and_of_a_travelling_wave():
    rows = check_rows(recording("a", 26.84, 0.0028).identification)
    assert [row.holds for row in rows] == [True] * 6, rows
    rows = check_rows(recording("a", 26.84, 0.0028, SHAPE * np.exp(0.9j * np.arange(4))).identification)
    assert not rows[-1].holds
    assert "do not move in phase" in rows[-1].text


def test_windows_give_frequency_and_damping_back():
    found = recording("a", 26.84, 0.0028).identification
    seen = instantaneous(found, found.modes[0], 3)
    assert seen.amplitude.size >= 5
    assert np.all(np.diff(seen.amplitude) < 0.0)
    # Chi-square of the windows about the truth: mean 1 each, a factor 2 for standard deviations from five spans.
    z = (seen.damping_ratio - 0.0028) / seen.damping_ratio_sd
    f = (seen.frequency_hz - 26.84) / seen.frequency_sd_hz
    assert np.median(np.abs(z)) < 2.0
    assert np.median(np.abs(f)) < 2.0
    assert np.median(np.abs(seen.frequency_hz - 26.84)) < 0.01
