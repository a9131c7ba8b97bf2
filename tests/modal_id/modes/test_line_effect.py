"""The stated effect of a vibration that was not fitted, against fits of records with and without it."""

import numpy as np
import pytest
from kit.identified import quick
from kit.series import one_mode, series_of

from modal_id.modes import line_effect

AMPLITUDE = 0.02


def fitted(time_s, values):
    found = quick(series_of(time_s, values), max_modes=1, onset_s=0.0)
    return found, found.modes[0]


@pytest.mark.parametrize("distance", [0.12, pytest.param(0.4, marks=pytest.mark.slow)])
def test_the_effect_is_the_largest_change_over_the_phases_of_the_vibration(distance):
    series, *_ = one_mode(2, 1, fps=250.0, duration_s=3.0)
    time_s, values = series.time_s, series.values[:, 0]
    _, alone = fitted(time_s, values)
    line_hz = alone.frequency_hz * (1.0 + distance)
    size = AMPLITUDE * alone.amplitude
    changes, stated = [], []
    for phase in np.arange(4) * np.pi / 4.0:
        found, mode = fitted(time_s, values + size * np.cos(2.0 * np.pi * line_hz * time_s + phase))
        changes.append([mode.frequency_hz - alone.frequency_hz, mode.damping_ratio - alone.damping_ratio])
        stated.append(line_effect(found, mode, line_hz))
    largest = np.max(np.abs(changes), axis=0)
    # Of a sinusoid over the phase, the largest of four values pi / 4 apart is at least cos(pi / 8) = 0.92 of the peak.
    np.testing.assert_allclose(
        largest,
        np.mean(stated, axis=0),
        rtol=0.2,
        err_msg="first order in a vibration of 2 % of the amplitude: 8 % for the phases, the rest for second order",
    )


def test_a_distant_line_at_the_level_of_the_noise_changes_nothing():
    series, *_ = one_mode(2, 1, fps=250.0, duration_s=3.0)
    found, mode = fitted(series.time_s, series.values[:, 0])
    effect = line_effect(found, mode, 2.5 * mode.frequency_hz)
    assert effect.frequency_hz < mode.frequency_sd_hz
    assert effect.damping_ratio < mode.damping_ratio_sd, "a bin of white noise away from the mode is no bias"
