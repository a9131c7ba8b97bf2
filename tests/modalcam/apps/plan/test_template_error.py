"""Template noise in a predicted standard deviation against simulated least-squares fits."""

import numpy as np
import pytest

from modal_id.data import bandwidth_hz, baseline_matrix
from modalcam.apps.plan import template_factors
from tracker import position_errors


def test_the_template_factor_matches_fits_with_the_error_among_the_unknowns():
    """The scatter of damping with an error that varies over the pixel: simulated fits against the formula."""
    rng = np.random.default_rng(6)
    frequency, zeta, amplitude, sd = 10.0, 0.004, 0.9, 0.006
    time = np.arange(2000) / 500.0
    pole = 2.0 * np.pi * frequency * complex(-zeta, np.sqrt(1.0 - zeta**2))
    drift = np.linalg.qr(baseline_matrix(time, bandwidth_hz(frequency)))[0]
    found = {False: [], True: []}
    for _ in range(200):
        wave = amplitude * np.exp(pole * time + 1j * rng.uniform(0.0, 2.0 * np.pi))
        noise = sd * rng.standard_normal(time.size)
        turn = 2.0 * np.pi * (wave.real + rng.uniform())
        shapes = [f(h * turn) / h for h in (1, 2) for f in (np.cos, np.sin)]
        error = position_errors.TUNING.lossless_share * sd * np.column_stack(shapes)
        # One Gauss-Newton step from the true values, with the drift projected out.
        columns = np.column_stack([(time * wave).real, (1j * time * wave).real, wave.real, wave.imag])
        for biased, changes in found.items():
            design = np.column_stack([columns, error]) if biased else columns
            design = design - drift @ (drift.T @ design)
            gram = design.T @ design
            # The coefficients of the error are standard normal: a prior as strong as one sample of the noise.
            gram[4:, 4:] += sd**2 * np.eye(design.shape[1] - 4)
            data = noise + biased * error @ rng.standard_normal(error.shape[1])
            changes.append(-np.linalg.solve(gram, design.T @ data)[0] / abs(pole))
    ratio = np.std(found[True]) / np.std(found[False])
    factor = template_factors(time, frequency, zeta, np.array([amplitude]), np.array([sd]))[1]
    assert factor > 1.3, f"a motion of {amplitude} px: the factor is {factor:.2f}"
    # Ratio of two standard deviations from 200 fits with common noise: its sd is at most sqrt(2 / 400); 3 sd.
    assert ratio == pytest.approx(factor, rel=3.0 * np.sqrt(2.0 / 400.0)), f"{ratio:.2f} for {factor:.2f}"


def test_a_motion_of_many_pixels_or_a_hundredth_hides_no_damping():
    """Far above and far below a pixel the error is not in phase with the motion, or proportional to it."""
    time = np.arange(1500) / 500.0
    for amplitude in (0.01, 40.0):
        factor = template_factors(time, 20.0, 0.004, np.array([amplitude]), np.array([0.006]))[1]
        assert factor == pytest.approx(1.0, abs=0.02), f"{amplitude} px: factor {factor:.3f}"


def test_markers_at_rest_have_no_template_error():
    """Such as a single marker at the clamp: its bounds are infinite, and stay so."""
    assert template_factors(np.arange(100) / 500.0, 20.0, 0.004, np.zeros(1), np.full(1, 0.006)) == (1.0, 1.0)
