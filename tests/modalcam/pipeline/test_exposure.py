"""Correction of amplitudes for the exposure time, and its notes."""

import numpy as np
import pytest
from kit import runs

from modalcam.pipeline import correct_amplitudes


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
