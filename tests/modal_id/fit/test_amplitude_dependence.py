"""zeta(a) = zeta0 + zeta1 a at 40 dB: detection rate, false detections and coverage of the intervals."""

import numpy as np
import pytest
from kit.series import PAPER_HZ, PAPER_ZETA, series_of
from scipy.integrate import solve_ivp
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


@pytest.mark.parametrize("power", [1, 2])
def test_derivatives_of_the_nonlinear_decay(power):
    t = np.sort(np.random.default_rng(0).uniform(0, 5, 4000))
    at = np.array([0.4, 60.0, 0.15, 0.3])
    slopes = nonlinear_decay(t, at, power)[1][:].view(complex)
    for i, step in enumerate((1e-6, 1e-6, 1e-6, 1e-6)):
        up, down = at.copy(), at.copy()
        up[i] += step
        down[i] -= step
        waves = [nonlinear_decay(t, moved, power)[0][:].view(complex)[:, 0] for moved in (up, down)]
        numeric = (waves[0] - waves[1]) / (2 * step)
        # Error of central differences: step^2 times the third derivative (t^3 <= 125) plus rounding / step.
        np.testing.assert_allclose(slopes[:, i], numeric, atol=1e-8)


@pytest.mark.parametrize("power", [1, 2])
def test_the_nonlinear_decay_solves_its_equation(power):
    p0, p1, p2, p3 = parameters = (0.4, 60.0, 0.9, -0.5)

    def rate(_, log_wave):
        a = np.exp(log_wave[0])
        return [-(p0 + p2 * a**power), p1 + p3 * a**2]

    t = np.linspace(0.0, 5.0, 4001)
    log_a, phase = solve_ivp(rate, (0.0, 5.0), [0.0, 0.0], t_eval=t, rtol=1e-11, atol=1e-12).y
    wave = nonlinear_decay(t, np.array(parameters), power)[0][:].view(complex)[:, 0]
    # The trapezoidal rule for the integral of a^2: step^2 / 12 times the change of its slope (at most 2.6), times p3.
    np.testing.assert_allclose(wave, np.exp(log_a + 1j * phase), atol=0.5 * 1.25e-3**2 / 12 * 2.6 + 1e-9)


def test_the_limit_at_zero_amplitude_allows_for_the_form_of_the_dependence():
    """zeta (1 + 2 a^2) in a record of a dozen cycles, where no curve of any form can be fitted."""
    rng, errors = np.random.default_rng(5), []
    for _ in range(3):
        hz, zeta = rng.uniform(5.0, 30.0), rng.uniform(0.02, 0.05)
        omega = 2 * np.pi * hz
        t = np.arange(0.0, 14 / hz, 1 / (40 * hz))
        a = nonlinear_decay(t, np.array([zeta * omega, omega, 2 * zeta * omega, 0.0]), 2)[0][:][:, 0]
        model = find_modes(prepare(series_of(t, a + 1e-3 * rng.standard_normal(t.size))).data, 8)
        dependence = determine_mode(model, model.strongest).dependence
        assert dependence.significant
        assert dependence.curve is None
        value, sd = dependence.small_amplitude_damping
        errors.append((value - zeta) / sd)
    # chi-square of 3 values: 99.9 % below 16.3
    assert np.sum(np.square(errors)) < 16.3, errors
