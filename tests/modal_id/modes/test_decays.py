"""Several decays in one record."""

import numpy as np
import pytest
from kit.identified import assert_inside, quick
from kit.series import decay, series_of

FPS, FREQUENCY_HZ, PLUCK_S = 125.0, 12.0, 6.0
ZETA_SMALL, ZETA_LARGE = 0.003, 0.008


def plucks(count, seed):
    """Decays from amplitude 1 whose damping ratio is linear in the amplitude, one after the other."""
    rng = np.random.default_rng([seed, 11])
    t = np.arange(int(PLUCK_S * FPS)) / FPS
    amplitude = np.empty(t.size)
    amplitude[0] = 1.0
    for i in range(1, t.size):
        zeta = ZETA_SMALL + (ZETA_LARGE - ZETA_SMALL) * amplitude[i - 1]
        amplitude[i] = amplitude[i - 1] * np.exp(-zeta * 2.0 * np.pi * FREQUENCY_HZ / FPS)
    one = amplitude * np.cos(2.0 * np.pi * FREQUENCY_HZ * t)
    y = np.tile(one, count) + 0.002 * rng.standard_normal(count * t.size)
    return series_of(np.arange(y.size) / FPS, y)


@pytest.mark.parametrize("count", [2, pytest.param(4, marks=pytest.mark.slow)])
def test_more_decays_do_not_average_out_what_changes_with_the_amplitude(count):
    """Every decay runs through the same amplitudes: all of them need the interval that one needs to reach both ends."""
    one, many = (quick(plucks(n, 1)).target for n in (1, count))
    assert len(many.decays) == count
    for mode in (one, many):
        assert "AMPLITUDE_DEPENDENT" in mode.flags
        for true in (ZETA_SMALL, ZETA_LARGE):
            assert abs(mode.damping_ratio - true) < 3.0 * mode.damping_ratio_sd, f"{mode} for {true}"
    ratio = many.damping_ratio_sd / one.damping_ratio_sd
    averaged = count**-0.5
    assert ratio > 0.9, f"the interval of {count} decays is {ratio:.2f} of one's: averaged, {averaged:.2f}"


def test_a_mode_that_only_a_less_informative_decay_shows_is_listed_with_that_decay():
    """The second pluck is longer and gives the modes; the first one alone excites the mode at 31 Hz."""
    t = np.arange(int(12.0 * FPS)) / FPS
    y = decay(t, 12.0, 0.004) + (t < 4.0) * decay(t, 31.0, 0.01, 0.6)
    y[t >= 4.0] = decay(t[t >= 4.0] - 4.0, 12.0, 0.004)
    found = quick(series_of(t, y + 0.002 * np.random.default_rng(5).standard_normal(t.size)))
    of_fit, other = found.modes
    assert found.target is of_fit
    assert found.fitted_modes == (of_fit,)
    assert found.onset.time_s == pytest.approx(4.0, abs=0.1)
    assert len(of_fit.decays) == 2, "both decays show it"
    assert_inside(of_fit, 12.0, 0.004)
    assert_inside(other, 31.0, 0.01)
    assert of_fit.posterior.seed != other.posterior.seed, "draws of their own"
    clock = [mode.posterior.rate_factors(50.0)[0, :9] for mode in found.modes]
    np.testing.assert_array_equal(*clock, "the error of the frame rate is common")
    assert other.notes[-1].startswith("Only the decay from 0 s to ")
