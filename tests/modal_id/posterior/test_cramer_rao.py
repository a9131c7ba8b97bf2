"""Cramer-Rao bound of frequency and damping ratio, compared with numerical information and with fits."""

import numpy as np
import pytest

from modal_id.posterior import modal_bound

TIME_S = np.arange(1500) / 500.0
F, ZETA, SD = 12.0, 0.006, 0.02
AMPLITUDE = np.array([1.0, -0.4])


def motion(p):
    """Decays of two markers; p contains f, zeta and, for each marker, cosine, sine and offset."""
    w = 2 * np.pi * p[0]
    envelope, phase = np.exp(-p[1] * w * TIME_S), w * np.sqrt(1 - p[1] ** 2) * TIME_S
    parts = [envelope * (c * np.cos(phase) + s * np.sin(phase)) + o for c, s, o in p[2:].reshape(2, 3)]
    return np.concatenate(parts)


def truth(phase_rad):
    linear = [[a * np.cos(phase_rad), -a * np.sin(phase_rad), 0.0] for a in AMPLITUDE]
    return np.array([F, ZETA, *np.ravel(linear)])


def slopes_at(p):
    """Central differences of the motion, one row per parameter."""
    steps = 1e-6 * np.maximum(np.abs(p), 1.0)
    return np.array([(motion(p + h) - motion(p - h)) / (2 * h.sum()) for h in np.diag(steps)])


def fitted(y, p):
    """Least squares by Gauss-Newton, until the step is a thousandth of each parameter's sd."""
    for _ in range(10):
        slopes = slopes_at(p)
        information = slopes @ slopes.T
        step = np.linalg.solve(information, slopes @ (y - motion(p)))
        p = p + step
        if step @ information @ step < (1e-3 * SD) ** 2:
            return p
    pytest.fail("Gauss-Newton did not converge within ten steps from the true values")


def test_bound_is_the_inverse_of_the_numerical_information():
    slopes = slopes_at(truth(0.7))
    expected = SD * np.sqrt(np.diag(np.linalg.inv(slopes @ slopes.T)))
    bound = modal_bound(TIME_S, F, ZETA, AMPLITUDE, 0.7, np.full(2, SD), with_drift=False)
    # Only the numerical model includes an offset, which is orthogonal to 36 cycles within 1e-3.
    assert bound.frequency_sd_hz == pytest.approx(expected[0], rel=2e-3)
    assert bound.damping_sd == pytest.approx(expected[1], rel=2e-3)


def test_least_squares_reaches_the_bound():
    rng = np.random.default_rng(3)
    clean = motion(truth(0.2))
    fits = [fitted(clean + rng.normal(0.0, SD, clean.size), truth(0.2))[:2] for _ in range(120)]
    spread = np.std(fits, axis=0, ddof=1)
    bound = modal_bound(TIME_S, F, ZETA, AMPLITUDE, 0.2, np.full(2, SD))
    # The sd estimated from 120 fits has a relative sd of 6.5 %; the tolerance is three times that.
    assert spread[0] / bound.frequency_sd_hz == pytest.approx(1.0, abs=0.2)
    assert spread[1] / bound.damping_sd == pytest.approx(1.0, abs=0.2)


def test_samples_without_information_change_nothing():
    sd = np.full((TIME_S.size, 2), SD)
    sd[::3] = 1e9
    kept = np.delete(np.arange(TIME_S.size), np.s_[::3])
    masked = modal_bound(TIME_S, F, ZETA, AMPLITUDE, 0.0, sd, with_drift=False)
    fewer = modal_bound(TIME_S[kept], F, ZETA, AMPLITUDE, 0.0, np.full(2, SD), with_drift=False)
    assert masked.damping_sd == pytest.approx(fewer.damping_sd, rel=1e-6)


def test_a_marker_at_a_node_adds_no_information():
    alone = modal_bound(TIME_S, F, ZETA, AMPLITUDE[:1], 0.0, np.full(1, SD))
    with_node = modal_bound(TIME_S, F, ZETA, np.array([1.0, 0.0]), 0.0, np.full(2, SD))
    assert with_node.damping_sd == pytest.approx(alone.damping_sd, rel=1e-9)
    motionless = modal_bound(TIME_S, F, ZETA, np.zeros(2), 0.0, np.full(2, SD))
    assert np.isinf(motionless.damping_sd)
