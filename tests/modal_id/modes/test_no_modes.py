import numpy as np
import pytest
from kit.series import decay, errors_of_positions, series_of

from modal_id import IdentifySettings, identify

RATE_HZ, SPAN_S = 500.0, 6.0
F_HZ, ZETA = 11.3, 0.004
TIME_S = np.arange(int(RATE_HZ * SPAN_S)) / RATE_HZ


def _found(y, errors=None, settings=None):
    y = y + 0.01 * np.random.default_rng(1).standard_normal(y.size)
    found = identify(series_of(TIME_S, y, position_errors=errors), settings)
    assert found, found
    return found


def _listed(found):
    return [round(m.frequency_hz, 1) for m in found.modes]


def test_harmonics_of_a_sensor_that_is_not_linear_are_no_modes():
    """x + c x^2 + d x^3 of a decay has lines at 2 f and 3 f that decay at 2 and 3 times the rate, by trigonometry."""
    x = decay(TIME_S, F_HZ, ZETA, 10.0)
    found = _found(x + 0.004 * x**2 + 0.0006 * x**3)
    assert _listed(found) == [F_HZ]
    assert np.allclose([f.frequency_hz for f in found.failed], [2.0 * F_HZ, 3.0 * F_HZ], atol=0.01)
    assert "not a mode of its own" in found.failed[0].reason


def test_a_harmonic_above_half_the_sampling_rate_is_no_mode_at_its_alias():
    """Twice 131.3 Hz, sampled at 500 Hz, lies at 500 - 262.6 = 237.4 Hz."""
    x = decay(TIME_S, 131.3, 0.0006, 10.0)
    found = _found(x + 0.004 * x**2)
    assert _listed(found) == [131.3]
    assert found.failed[0].frequency_hz == pytest.approx(237.4, abs=0.01)
    assert "262.6 Hz, aliased" in found.failed[0].reason


def test_sums_and_differences_of_two_modes_are_no_modes():
    """x^2 of two decays has lines at the sum and the difference of their frequencies and at twice each of them."""
    x = decay(TIME_S, F_HZ, ZETA, 10.0) + decay(TIME_S, 70.9, 0.002, 6.0)
    found = _found(x + 0.003 * x**2)
    assert _listed(found) == [F_HZ, 70.9]


@pytest.mark.parametrize("zeta", [0.001, 0.02])
def test_a_mode_at_a_multiple_with_a_decay_rate_of_its_own_is_a_mode(zeta):
    found = _found(decay(TIME_S, F_HZ, ZETA, 10.0) + decay(TIME_S, 3.0 * F_HZ, zeta, 0.4))
    assert _listed(found) == [F_HZ, round(3.0 * F_HZ, 1)]


def test_a_weak_mode_beside_a_multiple_is_a_mode():
    """6.27 times the first frequency, as the second bending mode of a beam, at the same damping ratio."""
    found = _found(decay(TIME_S, F_HZ, ZETA, 10.0) + decay(TIME_S, 6.27 * F_HZ, ZETA, 0.05))
    assert _listed(found) == [F_HZ, round(6.27 * F_HZ, 1)]


def test_a_harmonic_that_exceeds_noise_by_more_is_not_the_target():
    """A pendulum: y is the square of x, at twice the frequency, in a channel with a hundredth of the noise."""
    x, rng = decay(TIME_S, F_HZ, ZETA, 10.0), np.random.default_rng(1)
    noise = rng.standard_normal((TIME_S.size, 2)) * [0.3, 0.003]
    found = identify(series_of(TIME_S, np.column_stack([x, 0.02 * x**2]) + noise))
    assert (_listed(found), found.modes[0].target) == ([F_HZ], True)
    assert "not a mode of its own" in found.failed[0].reason


def test_a_mode_that_theory_expects_at_a_multiple_is_listed_with_a_flag():
    x = decay(TIME_S, F_HZ, ZETA, 10.0)
    settings = IdentifySettings(expected_frequencies_hz=(11.0, 22.9))
    found = _found(x + 0.004 * x**2, settings=settings)
    assert [m.number for m in found.modes] == [1, 2]
    assert "HARMONIC" in found.modes[1].flags
    assert "HARMONIC" not in found.modes[0].flags


@pytest.mark.parametrize(("amplitude", "listed"), [(0.03, False), (0.3, True)])
def test_a_line_within_the_errors_of_positions_is_no_mode(amplitude, listed):
    """Errors of 0.02 px in either quadrature: lines of less than 2 sqrt(2) 0.02 = 0.057 px may be errors."""
    errors = errors_of_positions(1, rest_px=200.0, px_per_unit=1.0, periodic_sd=0.02, along_px=1.0)
    y = decay(TIME_S, F_HZ, ZETA, 10.3) + decay(TIME_S, 81.7, 0.001, amplitude)
    assert (81.7 in _listed(_found(y, errors))) is listed
