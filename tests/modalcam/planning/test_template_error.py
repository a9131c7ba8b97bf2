"""Template noise in a predicted standard deviation against simulated least-squares fits."""

import numpy as np
import pytest

from modal_id.data.baseline import bandwidth_hz, baseline_matrix
from modalcam.planning.template_error import BIAS_SHARE, template_factors


def test_the_template_factor_matches_biased_least_squares_fits():
    """The scatter of damping due to a bias that varies over the pixel: simulated fits against the formula."""
    rng = np.random.default_rng(6)
    frequency, zeta, amplitude, sd = 10.0, 0.004, 0.9, 0.006
    time = np.arange(2000) / 500.0
    pole = 2.0 * np.pi * frequency * complex(-zeta, np.sqrt(1.0 - zeta**2))
    drift = np.linalg.qr(baseline_matrix(time, bandwidth_hz(frequency)))[0]
    found = {False: [], True: []}
    for _ in range(80):
        wave = amplitude * np.exp(pole * time + 1j * rng.uniform(0.0, 2.0 * np.pi))
        noise = sd * rng.standard_normal(time.size)
        a, b = BIAS_SHARE * sd * rng.standard_normal(2)
        bias = a * np.cos(2.0 * np.pi * wave.real) + b * np.sin(2.0 * np.pi * wave.real)
        # One Gauss-Newton step from the true values, with the drift projected out.
        columns = np.column_stack([(time * wave).real, (1j * time * wave).real, wave.real, wave.imag])
        columns -= drift @ (drift.T @ columns)
        for biased, changes in found.items():
            change = np.linalg.lstsq(columns, noise + biased * bias, rcond=None)[0][0]
            changes.append(-change / abs(pole))
    ratio = np.std(found[True]) / np.std(found[False])
    factor = template_factors(time, frequency, zeta, np.array([amplitude]), np.array([sd]))[1]
    assert factor > 1.5
    # Ratio of two standard deviations from 80 fits with common noise: its sd is at most sqrt(2 / 160); 3 sd.
    assert ratio == pytest.approx(factor, rel=3.0 * np.sqrt(2.0 / 160.0))
