"""Records in which the amplitude hardly decreases: damping ratio at their amplitudes, and at small amplitude."""

import numpy as np
import pytest
from kit.identified import quick
from kit.series import series_of
from scipy.stats import chi2

SEEDS = range(4)
FREQUENCY_HZ, ZETA = 32.0, 3.5e-4
# One value in a thousand sets of this many normal ones exceeds it.
MOST = chi2.isf(1e-3, len(SEEDS))


def fork(seed, samples=882):
    """zeta = zeta0 (1 + slope a) with random slope; zeta0, zeta at the middle.

    A fork that keeps 0.78 of its amplitude in 882 samples, 0.4 in 3200.

    The slope has the standard deviation 1/4: damping falls by a sixth while the amplitude falls to a third.
    """
    rng = np.random.default_rng(seed)
    slope = 0.25 * rng.standard_normal()
    t = np.arange(samples) / 250.0
    omega = 2.0 * np.pi * FREQUENCY_HZ
    zeta0 = ZETA / (1.0 + slope)
    lost = -np.expm1(-zeta0 * omega * t)
    a = (1.0 - lost) / (1.0 + slope * lost)
    y = 1.9 * a * np.cos(omega * t + 0.7) + 0.04 * rng.standard_normal(t.size)
    return series_of(t, y), zeta0, zeta0 * (1.0 + slope * 0.5 * (1.0 + a[-1]))


def test_both_damping_ratios_agree_with_the_truth():
    z, small_z = [], []
    for seed in SEEDS:
        series, zeta0, middle = fork(seed)
        target = quick(series).target
        assert "FEW_CYCLES_LOST" in target.flags
        z.append((target.damping_ratio - middle) / target.damping_ratio_sd)
        value, sd = target.small_amplitude_damping
        assert sd > 5.0 * target.damping_ratio_sd, "extrapolated over three quarters of the amplitude"
        small_z.append((value - zeta0) / sd)
    assert np.sum(np.square(z)) < MOST, np.round(z, 2)
    assert np.sum(np.square(small_z)) < MOST, np.round(small_z, 2)


def test_the_value_at_small_amplitude_allows_for_a_slope_that_noise_hides():
    """0.4 of the amplitude is left, and no dependence is significant: the limit is an extrapolation still."""
    small_z, own_z = [], []
    for seed in SEEDS:
        series, zeta0, _ = fork(seed, 3200)
        target = quick(series).target
        value, sd = target.small_amplitude_damping
        small_z.append((value - zeta0) / sd)
        own_z.append((target.damping_ratio - zeta0) / target.damping_ratio_sd)
    assert np.sum(np.square(small_z)) < MOST, np.round(small_z, 2)
    assert np.sum(np.square(own_z)) > MOST, "the interval of the record's own value would do"


@pytest.mark.parametrize("samples", [882, 3200])
def test_the_frequency_at_small_amplitude_allows_for_a_change_that_noise_hides(samples):
    """f = f0 (1 - 3e-5 a^2): no dependence is significant, and the constant is up to six of its sd from the limit."""
    small_z = []
    for seed in SEEDS:
        t = np.arange(samples) / 250.0
        a = np.exp(-ZETA * 2.0 * np.pi * FREQUENCY_HZ * t)
        turns = FREQUENCY_HZ * np.cumsum(1.0 - 3e-5 * a**2) / 250.0
        noise = 0.04 * np.random.default_rng(seed).standard_normal(t.size)
        target = quick(series_of(t, 1.9 * a * np.cos(2.0 * np.pi * turns) + noise)).target
        value, sd = target.small_amplitude_frequency
        small_z.append((value - FREQUENCY_HZ) / sd)
    assert np.sum(np.square(small_z)) < MOST, np.round(small_z, 2)
