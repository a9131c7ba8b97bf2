"""Which line is the first mode: of a wave whose tops are missing, and below the drift that a faster mode allows."""

import numpy as np
import pytest
from kit.identified import in_sd, quick
from kit.series import pole_of, series_of
from scipy.stats import chi2

# The plain spectrum of some of them is highest at the third overtone, which then kept out the wave itself.
SEEDS = [
    *(pytest.param(seed, id=str(seed)) for seed in (0, 4, 13, 20)),
    *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(24, 48)),
]


@pytest.mark.parametrize("seed", SEEDS)
def test_a_clipped_wave_is_no_overtone(seed):
    rng = np.random.default_rng([seed, 5])
    rate_hz = float(rng.choice([1000.0, 2000.0, 4000.0]))
    t = np.arange(int(rng.uniform(1.0, 3.0) * rate_hz)) / rate_hz
    f, zeta, amplitude = rng.uniform(10.0, 30.0), rng.uniform(0.002, 0.008), rng.uniform(1.5, 4.0)
    phase = np.exp(1j * rng.uniform(0.0, 6.0))
    y = (amplitude * phase * np.exp(pole_of(f, zeta) * t) + 0.3 * np.exp(pole_of(6.27 * f, 0.01) * t)).real
    y += 0.01 * rng.standard_normal(t.size)
    y[np.abs(y) > 1.0] = np.nan
    gap = np.abs(t - rng.uniform(0.2, 0.7) * t[-1]) < rng.uniform(0.2, 1.0) / f
    series = series_of(t, np.where(gap, np.nan, y))
    found = quick(series, onset_s=0.0, end_s=float(t[-1]))
    if np.mean(np.isfinite(series.values)) < 0.3:
        assert "samples have a value" in found.reason
        return
    mode = max(found.modes, key=lambda one: one.amplitude)
    errors = in_sd(mode, f, zeta)
    assert np.sum(np.square(errors)) < chi2.isf(1e-4, 2), f"{mode.frequency_hz} for {f} Hz; in sd {errors}"


def test_a_slow_mode_is_no_drift_beside_a_faster_one_that_stands_out_more():
    """22 cycles at 1.12 Hz: splines up to 1 Hz, which drift beside 29.6 Hz may need, take most of it."""
    t = np.arange(2000) / 100.0
    truths = {1.121: 0.0027, 29.578: 0.00042}
    y = sum(np.exp(pole_of(f, zeta) * t).real for f, zeta in truths.items())
    y = y + 0.004 * np.random.default_rng(1).standard_normal(t.size)
    found = quick(series_of(t, y))
    assert len(found.modes) == len(truths), found.modes
    for mode, (f, zeta) in zip(found.modes, truths.items(), strict=True):
        assert np.sum(np.square(in_sd(mode, f, zeta))) < chi2.isf(1e-4, 2), mode
