"""What the decay view shows: the curve, its spectrum, and what a run found."""

from dataclasses import replace

import numpy as np
import pytest
from kit import runs
from kit.series import series_of
from kit.tracks import sample_tracks

from modal_id import identify
from modalcam.apps.studio import (
    DecayTask,
    TrialDecayTask,
    amplitude_spectrum,
    decay_of,
    identified_trial,
    shown_decay,
    thinned,
)
from modalcam.config import RecordingConfig
from tracker import Failure


def test_a_thinned_curve_keeps_its_extremes_and_its_order():
    rng = np.random.default_rng(1)
    x, y = np.arange(100_003.0), rng.normal(size=100_003)
    points = np.array(thinned(x, y, 500))
    assert len(points) <= 500
    assert points[:, 1].min() == y.min()
    assert points[:, 1].max() == y.max()
    assert np.all(np.diff(points[:, 0]) > 0)
    assert np.array_equal(points[:, 1], y[points[:, 0].astype(int)])
    assert thinned(x[:3], y[:3]) == tuple(zip(x[:3], y[:3], strict=True))


def test_the_spectrum_of_a_sine_has_its_amplitude_and_frequency():
    time_s = np.arange(1000) / 500.0
    frequency_hz, amplitude = amplitude_spectrum(time_s, 3.0 + 0.7 * np.sin(2 * np.pi * 40.0 * time_s))
    assert frequency_hz[np.argmax(amplitude)] == pytest.approx(40.0)
    assert amplitude.max() == pytest.approx(0.7, rel=1e-6)
    # A Hann window leaves the frequencies beyond two bins untouched.
    assert np.delete(amplitude, range(77, 84)).max() < 1e-9


def test_the_spectrum_bridges_gaps():
    time_s = np.delete(np.arange(1000) / 500.0, range(300, 310))
    frequency_hz, amplitude = amplitude_spectrum(time_s, np.sin(2 * np.pi * 5.0 * time_s))
    assert frequency_hz[np.argmax(amplitude)] == pytest.approx(5.0)


def test_the_view_shows_the_modes_and_parts_of_the_run():
    found = runs.recording(0, seconds=1.0).identification
    decay = shown_decay(found.series, found)
    moves = np.nanmax(found.series.values, axis=0) - np.nanmin(found.series.values, axis=0)
    assert decay.channel == found.series.channels[int(np.argmax(moves))]
    assert [mode.frequency_hz for mode in decay.modes] == [mode.frequency_hz for mode in found.modes]
    assert sum(mode.target for mode in decay.modes) == 1
    assert decay.span_s == (found.series.time_s[0], found.series.time_s[-1])
    other = found.series.channels[0]
    assert shown_decay(found.series, found, other).channel == other
    used = found.series.time_s[found.used[:, found.series.channels.index(decay.channel)]]
    assert decay.fitted_s == (used[0], used[-1])
    curve, fit, residual = (np.array(c) for c in (decay.curve, decay.fit, decay.residual))
    inside = np.isfinite(fit[:, 1])
    assert np.array_equal(curve[inside, 0], used)
    assert np.allclose(curve[inside, 1], (fit + residual)[inside, 1])


def test_without_a_run_the_reason_is_given(tmp_path):
    found = decay_of(DecayTask(tmp_path, "a.avi"))
    assert isinstance(found, Failure)
    assert "holds no results" in found.reason


def test_the_stabilisation_chart_shows_the_mode_of_a_decay():
    """A pole at the frequency of the decay in every order, stable; poles of the noise lie elsewhere."""
    rng = np.random.default_rng(2)
    time_s = np.arange(1000) / 200.0
    values = np.exp(-0.3 * time_s) * np.cos(2 * np.pi * 11.0 * time_s) + 0.01 * rng.normal(size=1000)
    decay = shown_decay(series_of(time_s, values), identify(series_of(time_s, values)))
    stable = {pole.order for pole in decay.poles if pole.is_stable and abs(pole.frequency_hz - 11.0) < 0.02}
    assert stable == {pole.order for pole in decay.poles}
    assert not all(pole.is_stable for pole in decay.poles)


def test_a_track_is_identified_with_the_options_of_the_recording():
    tracks = sample_tracks()
    refused = identified_trial(TrialDecayTask(tracks, RecordingConfig(file="a", onset_s=1e6)))
    assert "samples lie within onset_s" in refused.reason
    unknown = replace(tracks, reference=("nothing",))
    found = identified_trial(TrialDecayTask(unknown, RecordingConfig(file="a")))
    assert "is not among the markers" in found.reason
