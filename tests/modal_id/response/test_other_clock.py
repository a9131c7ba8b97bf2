"""An input at other times than the outputs, against sinusoids and the momentum of impacts."""

import numpy as np
import pytest

from modal_id.response import at_other_times

OUTPUTS_S = np.arange(200) / 100.0


@pytest.mark.parametrize("rate_hz", [100.0, 130.0, 333.0, 5000.0])
def test_sinusoids_of_the_band_of_the_fit_are_unchanged(rate_hz: float) -> None:
    given_s = np.arange(-0.1, 2.1, 1.0 / rate_hz)
    for hz in (2.0, 20.0, 30.0):
        found = at_other_times(given_s, np.cos(2.0 * np.pi * hz * given_s + 0.3), OUTPUTS_S)
        error = np.max(np.abs(found - np.cos(2.0 * np.pi * hz * OUTPUTS_S + 0.3)))
        # Kaiser's window for 80 dB: ripple of 1e-4 in the pass band, and as much from each image of the stop band.
        assert error < 3e-4, f"{hz} Hz at {rate_hz} Hz: {error:.2g}, from the ripple of the filter"


def test_what_the_rate_of_the_outputs_would_fold_into_the_band_is_left_out() -> None:
    given_s = np.arange(-0.1, 2.1, 1.0 / 1000.0)
    found = at_other_times(given_s, np.cos(2.0 * np.pi * 72.0 * given_s), OUTPUTS_S)
    assert np.max(np.abs(found)) < 3e-4, "from the stop band of 80 dB, which begins at 70 Hz"


def test_an_impact_between_two_times_keeps_its_momentum() -> None:
    given_s = np.arange(0.0, 2.0, 1.0 / 20000.0)
    force = np.where(np.abs(given_s - 1.0037) < 5e-4, np.cos(np.pi * (given_s - 1.0037) / 1e-3), 0.0)
    found = at_other_times(given_s, force, OUTPUTS_S)
    given, kept = np.sum(force) / 20000.0, np.nansum(found) / 100.0
    # Sampled at 100 Hz, the filter passes momentum as it passes a constant, and an image of 80 dB.
    assert kept == pytest.approx(given, rel=3e-4), "from the ripple of the filter"


def test_what_was_not_recorded_is_missing_and_a_slower_recorder_is_refused() -> None:
    given_s = np.arange(0.5, 1.5, 1.0 / 1000.0)
    values = np.ones(given_s.size)
    values[500:600] = np.nan
    found = at_other_times(given_s, values, OUTPUTS_S)
    np.testing.assert_allclose(found[np.isfinite(found)], 1.0, rtol=1e-12)
    # Half the filter, 63 ms, is lost at each end and on both sides of the gap of 100 ms at most.
    known_s = OUTPUTS_S[np.isfinite(found)]
    gaps = ((known_s < 0.5) | (known_s > 1.5) | ((known_s > 1.0) & (known_s < 1.1))).any()
    assert not gaps
    assert 1.0 - 6 * 0.063 - 0.1 < known_s.size / 100.0 < 0.9
    refused = at_other_times(np.arange(0.0, 2.0, 0.02), np.zeros(100), OUTPUTS_S)
    assert "slower than the outputs at 100 Hz" in refused.reason
