"""zeta(a) = zeta0 + zeta1 a at 40 dB: detection rate, false detections and coverage of the intervals."""

import numpy as np
import pytest
from kit.series import PAPER_HZ, PAPER_ZETA, series_of
from scipy.stats import binom

from modal_id.data import prepare
from modal_id.fit import find_modes, nonlinear_decay
from modal_id.posterior import determine_mode

# 40 dB at 1000 fps, 36 dB at the 400 fps of these records: the same noise in each hertz.
NOISE = 0.00707 * np.sqrt(0.4)


def decay(mode, rise, seed):
    """Decay whose zeta varies by the fraction `rise` over the amplitudes of the record: (series, zeta0, zeta1)."""
    rng = np.random.default_rng([seed, mode, int(1000 * rise)])
    t = np.arange(4000) / 400
    omega, zeta0 = 2 * np.pi * PAPER_HZ[mode], PAPER_ZETA[mode]
    zeta1 = rise * zeta0 / (1 - np.exp(-zeta0 * omega * t[-1]))
    loss = -np.expm1(-zeta0 * omega * t)
    amplitude = (1 - loss) / (1 + zeta1 / zeta0 * loss)
    y = amplitude * np.cos(omega * t + 2 * np.pi * rng.random())
    return series_of(t, y + NOISE * rng.standard_normal(t.size)), zeta0, zeta1


def dependences(rise, seeds):
    for mode in range(5):
        for seed in seeds:
            series, zeta0, zeta1 = decay(mode, rise, seed)
            model = find_modes(prepare(series).data, 8)
            index = int(np.argmax(np.abs(model.fit.linear.amplitudes[:, 0])))
            yield determine_mode(model, index).dependence, zeta0, zeta1


# Mode 5 is above the noise for 2 s only: 2 % is 2.5 standard deviations of its slope at the Cramer-Rao bound.
NONE, SMALL, CLEAR = (0.0, 0.0, 0.03), (0.02, 0.70, 1.0), (0.05, 0.99, 1.0)
MANY = [pytest.param(*case, range(100, 200), marks=pytest.mark.slow) for case in (NONE, SMALL, CLEAR)]


@pytest.mark.timeout(1200)
@pytest.mark.parametrize(("rise", "least", "most", "seeds"), [(*NONE, range(3)), (*CLEAR, range(3)), *MANY])
def test_detection_rate_and_coverage(rise, least, most, seeds):
    """The detection rate against `least` and `most`, and the 90 % coverage of zeta0 and zeta1 (99.9 % band)."""
    results = list(dependences(rise, seeds))
    n = len(results)
    found = sum(d.significant for d, _, _ in results)
    assert binom.sf(found - 1, n, most) > 1e-3, f"{found} of {n} detected, expected at most {most:.0%}"
    assert binom.cdf(found, n, least) > 1e-3, f"{found} of {n} detected, expected at least {least:.0%}"
    low, high = binom.interval(0.999, n, 0.9)
    for name, hits in (
        ("zeta0", sum(abs(d.zeta0 - z0) < 1.645 * d.zeta0_sd for d, z0, _ in results)),
        ("zeta1", sum(abs(d.zeta1 - z1) < 1.645 * d.zeta1_sd for d, _, z1 in results)),
    ):
        assert low <= hits <= high, f"{name}: {hits} of {n} covered, {low:.0f} to {high:.0f} allowed"


def test_a_decay_within_one_sample_is_none():
    """No vibration below half the sampling rate loses more than exp(-pi) of its amplitude in a step."""
    t = np.arange(300) / 750.0
    assert nonlinear_decay(t, np.array([16000.0, 800.0, 0.0, 0.0])) is None
    assert nonlinear_decay(t, np.array([0.9 * np.pi * 750.0, 800.0, 0.0, 0.0])) is not None


def test_derivatives_of_the_nonlinear_decay():
    t = np.sort(np.random.default_rng(0).uniform(0, 5, 4000))
    at = np.array([0.4, 60.0, 0.15, 0.3])
    slopes = nonlinear_decay(t, at)[1][:].view(complex)
    for i, step in enumerate((1e-6, 1e-6, 1e-6, 1e-6)):
        up, down = at.copy(), at.copy()
        up[i] += step
        down[i] -= step
        numeric = (nonlinear_decay(t, up)[0][:] - nonlinear_decay(t, down)[0][:]).view(complex)[:, 0] / (
            2 * step
        )
        # Error of central differences: step^2 times the third derivative (t^3 <= 125) plus rounding / step.
        np.testing.assert_allclose(slopes[:, i], numeric, atol=1e-8)
