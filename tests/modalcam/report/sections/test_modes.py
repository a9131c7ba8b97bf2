"""Agreement of recordings and checks of the fit in the report."""

import re
from dataclasses import replace

import numpy as np
import pytest
from kit.identified import identification
from support.html_page import Page

from modal_id.modes import residual_checks
from modal_id.posterior import with_rate_error
from modalcam.pipeline import RecordingResult, RunResult, measured_modes
from modalcam.report import build_report, instantaneous
from modalcam.report.sections import Detail, recording_view

# only the text is tested
pytestmark = pytest.mark.usefixtures("no_figures")
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
    pair = result(recording("a", 26.84, 0.0028), recording("b", 26.8401, 0.00281))
    (mode,) = measured_modes(pair.recordings)
    assert mode.recordings == ("a", "b")
    assert mode.least_mac == pytest.approx(1.0, abs=1e-4)
    assert " agree " in Page(build_report(pair)).words.partition("Agreement of the recordings")[2]


def test_disagreeing_recordings_are_reported_with_a_larger_sd():
    # Standard deviations are 1e-5 of the frequency and half a percent of the damping ratio.
    pair = result(recording("a", 26.84, 0.0028), recording("b", 26.90, 0.0032))
    words = Page(build_report(pair)).words
    assert "The recordings of a mode disagree" in words
    between = (
        r"frequencies \(χ² = [\d.]+, 1 degree of freedom; standard deviation between recordings 0.042 Hz\)"
    )
    assert re.search(between + r" and damping ratios \(", words), "0.06 Hz apart: 0.06 / sqrt(2)"
    assert " differ " in words.partition("Agreement of the recordings")[2]
    (mode,) = measured_modes(pair.recordings)
    assert mode.frequency_sd_hz == pytest.approx(0.03, rel=1e-3), "half the distance of equally good values"
    assert mode.damping_ratio_sd == pytest.approx(0.0002, rel=0.02)


def test_the_error_of_the_frame_rate_does_not_average_out():
    """Two recordings of one camera, its rate known to 1000 ppm: their mean frequency is no better known than that."""
    pair = []
    for name, frequency_hz in (("a", 26.84), ("b", 26.8401)):
        one = recording(name, frequency_hz, 0.0028)
        series = replace(one.identification.series, rate_sd_ppm=1000.0)
        pair.append(replace(one, identification=with_rate_error(replace(one.identification, series=series))))
    (exact,) = measured_modes([recording("a", 26.84, 0.0028), recording("b", 26.8401, 0.0028)])
    (mode,) = measured_modes(pair)
    assert mode.frequency.sd == pytest.approx(exact.frequency_sd_hz, rel=1e-9)
    assert mode.frequency_sd_hz == pytest.approx(1e-3 * 26.84, rel=1e-3), "26.84 Hz times 1000 ppm"
    # of 32 draws, evenly spread over the chains of the posterior
    assert np.std(mode.frequency_draws_hz) == pytest.approx(mode.frequency_sd_hz, rel=0.5)
    assert mode.damping_ratio_sd == exact.damping_ratio_sd


def test_the_amplitude_has_its_sd_if_a_channel_is_not_used():
    one = recording("a", 26.84, 0.0028)
    (mode,) = one.identification.modes
    shape, shape_sd = mode.shape.copy(), np.full(mode.shape.size, 0.01)
    shape[0] = shape_sd[0] = np.nan
    found = replace(one.identification, modes=(replace(mode, shape=shape, shape_sd=shape_sd),))
    assert "1.000 ± 0.010" in Page(build_report(result(replace(one, identification=found)))).words


def test_one_recording_has_no_comparison():
    page = build_report(result(recording("a", 26.84, 0.0028)))
    assert "Agreement of the recordings" not in Page(page).words


def test_checks_of_a_good_fit_and_of_a_travelling_wave():
    detail = Detail(strips=1, diagnostics=False, figures=True)
    good = recording("a", 26.84, 0.0028)
    checked = replace(good.identification, checks=residual_checks(good.identification))
    view = recording_view(0, replace(good, identification=checked), None, detail)
    assert [check.holds for check in view["checks"]] == [True] * 5, view["checks"]
    assert view["mpc"] > 0.95
    wave = recording("a", 26.84, 0.0028, SHAPE * np.exp(0.9j * np.arange(4)))
    assert recording_view(0, wave, None, detail)["mpc"] < 0.95
    assert "The markers do not move in phase" in Page(build_report(result(wave))).words


def test_windows_reproduce_frequency_and_damping():
    found = recording("a", 26.84, 0.0028).identification
    windows = instantaneous(found, found.modes[0], 3)
    assert windows.amplitude.size >= 5
    assert np.all(np.diff(windows.amplitude) < 0.0)
    # The errors have unit variance; a factor of 2 allows for standard deviations from five windows.
    z = (windows.damping_ratio - 0.0028) / windows.damping_ratio_sd
    f = (windows.frequency_hz - 26.84) / windows.frequency_sd_hz
    assert np.median(np.abs(z)) < 2.0
    assert np.median(np.abs(f)) < 2.0
    assert np.median(np.abs(windows.frequency_hz - 26.84)) < 0.01
