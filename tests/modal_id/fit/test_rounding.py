"""Values rounded to whole steps: their error returns with the motion, and its effect on the poles is simulated."""

from functools import cache

import numpy as np
from kit.series import decay, series_of

from modal_id.data import prepare
from modal_id.fit import find_modes, with_rounding_errors

T = np.arange(1000) / 500.0


def fits(seed, noise):
    """Fit of a decay of three steps before and after the errors of rounding are added, and its decay rate."""
    rng = np.random.default_rng(seed)
    hz, zeta = rng.uniform(8.0, 40.0), 10.0 ** rng.uniform(-3.0, -2.3)
    values = decay(T, hz, zeta, 3.0, rng.uniform(0.0, 6.28)) + rng.uniform(0.0, 1.0)
    series = series_of(T, np.round(values + noise * rng.standard_normal(T.size)))
    model = find_modes(prepare(series).data, 1)
    return model, with_rounding_errors(model, series, np.array([0])), -2.0 * np.pi * hz * zeta


@cache
def errors():
    """Errors of the decay rate of 40 decays, their sd by noise alone, and with those of rounding."""
    found = []
    for seed in range(40):
        before, after, rate = fits(seed, 0.0)
        variance = float(before.fit.covariance[0, 0])
        error = float(before.fit.poles[0].real) - rate
        found.append((error, np.sqrt(variance), np.sqrt(variance + after.repeating[0, 0])))
    return np.array(found).T


def test_the_sd_with_rounding_is_that_of_the_errors():
    error, noise, both = errors()
    # The rms of 40 standard normal values is below 1.4 and above 0.6 in all but 0.1 %; the sd of each is that of 16
    # simulated records, known to 18 %.
    assert 0.6 < np.sqrt(np.mean((error / both) ** 2)) < 1.6
    assert np.sqrt(np.mean((error / noise) ** 2)) > 1.6, "noise alone does not explain the errors"


def test_noise_of_a_step_averages_rounding_out():
    """Noise of 0.6 steps leaves exp(-2 pi^2 0.36) = 8e-4 of the error that returns."""
    before, after, _ = fits(1, 0.6)
    assert after is before


def test_values_that_are_not_rounded_are_left_alone():
    values = decay(T, 11.0, 0.004, 3.0, 0.4)
    series = series_of(T, values)
    model = find_modes(prepare(series).data, 1)
    assert with_rounding_errors(model, series, np.array([0])) is model
