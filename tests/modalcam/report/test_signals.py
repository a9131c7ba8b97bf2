"""Quantities that figures derive from a fit, against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from kit import runs
from scipy.stats import linregress

from modalcam.report import (
    highest,
    line_slope,
    measured_envelope,
    mode_motion,
    nrmse_of_fit,
    residual,
    shown_channel,
    shown_mode,
    spectral_density,
    widest_and_narrowest,
)
from modalcam.report.figures import in_phase, rayleigh_damping_ratio


def identification(number=2, **more):
    return runs.recording(0, number=number, frequency_hz=10.19, damping_ratio=0.0028, **more).identification


def test_doubtful_decays_come_first_then_the_widest_interval():
    recordings = [runs.recording(i, seconds=1.5) for i in range(4)]
    targets = [r.identification.target for r in recordings]
    by_width = [recordings[i] for i in np.argsort([m.damping_ratio_sd / m.damping_ratio for m in targets])]
    assert widest_and_narrowest(runs.run_result(recordings)) == [by_width[-1], by_width[0]]
    middle = recordings.index(by_width[1])
    recordings[middle] = runs.recording(middle, seconds=1.5, flags=("HARMONIC",))
    assert widest_and_narrowest(runs.run_result(recordings)) == [recordings[middle], by_width[0]]
    assert widest_and_narrowest(runs.run_result(recordings[:1])) == recordings[:1]
    assert widest_and_narrowest(runs.run_result([])) == []


def test_the_envelope_is_that_of_eq_1():
    found = identification()
    mode, channel = shown_mode(found), shown_channel(found)
    time_s, amplitude = measured_envelope(found, mode, channel)
    since = time_s - found.onset.fit_from_s
    expected = np.abs(mode.shape[channel]) * np.exp(-mode.damping_ratio * mode.omega_n_rad_s * since)
    # White noise of sd s gives an amplitude fitted to n >= 40 samples an sd of s sqrt(2 / n): five of these.
    tolerance = 5.0 * found.residual_sd[channel] * np.sqrt(2.0 / 40.0)
    np.testing.assert_allclose(amplitude, expected, atol=tolerance)
    assert time_s.size > 20


def test_a_mode_of_another_decay_is_not_in_the_figures_of_this_one():
    found = identification()
    other = replace(shown_mode(found), other_from_s=0.5, amplitude=1e3, target=False)
    both = replace(found, modes=(*found.modes, other))
    assert shown_mode(both) is shown_mode(found)
    for one, two in zip(*(measured_envelope(f, shown_mode(f), 1) for f in (found, both)), strict=True):
        np.testing.assert_array_equal(one, two)


def test_the_motion_of_a_mode_solves_its_equation():
    mode = shown_mode(identification())
    t = np.linspace(0.0, 0.3, 30001)
    x = mode_motion(mode, t, 1)
    h, omega = t[1], mode.omega_n_rad_s
    acceleration = (x[2:] - 2.0 * x[1:-1] + x[:-2]) / h**2
    velocity = (x[2:] - x[:-2]) / (2.0 * h)
    left = acceleration + 2.0 * mode.damping_ratio * omega * velocity + omega**2 * x[1:-1]
    # Errors of central differences: (omega h)^2 / 12 of the acceleration, rounding of 1e-16 / h^2 of x.
    assert np.max(np.abs(left)) < ((omega * h) ** 2 + 1e-15 / h**2 / omega**2) * omega**2 * np.max(np.abs(x))


def test_the_residual_is_the_noise():
    found = identification()
    left = residual(found)
    np.testing.assert_array_equal(np.isfinite(left), found.used)
    # 1800 samples: the sd of an sd is 1.7 %.
    np.testing.assert_allclose(np.nanstd(left, axis=0), 0.02, rtol=0.09)


def test_the_lowest_nrmse_is_noise_over_motion():
    found = identification()
    motion = (found.fitted - found.baseline)[found.used]
    expected = 0.02 / np.sqrt(np.mean(motion**2) + 0.02**2)
    # 9000 samples: the sd of their rms is 0.8 %.
    np.testing.assert_allclose(nrmse_of_fit(found), expected, rtol=0.04)


def test_the_spectrum_of_white_noise_is_independent_of_lost_samples():
    rng = np.random.default_rng(3)
    t, sd = np.arange(40_000) / 500.0, 0.02
    noise = sd * rng.standard_normal(t.size)
    noise[1:-1][rng.random(t.size - 2) < 0.3] = np.nan
    frequency, density = spectral_density(t, noise)
    np.testing.assert_allclose(frequency[-1], 250.0, rtol=1e-9)
    # One-sided: sd^2 / (fs / 2); 20 000 bins of a chi-square with two degrees of freedom average to 0.7 %.
    np.testing.assert_allclose(np.mean(density**2), sd**2 / 250.0, rtol=0.035)


def test_too_few_values_give_an_empty_spectrum():
    frequency, density = spectral_density(np.arange(20.0), np.full(20, np.nan))
    assert frequency.size == density.size == 0


def test_highest_keeps_the_peak():
    x = np.arange(1000.0)
    y = np.zeros(1000)
    y[637] = 5.0
    thin_x, thin_y = highest(x, y, 100)
    assert thin_y.max() == 5.0
    assert abs(thin_x[np.argmax(thin_y)] - 637) <= 5.0
    assert thin_x.size == 100


def test_the_common_phase_of_a_shape_is_removed():
    real = np.array([0.1, -0.5, 1.0])
    rotated = in_phase(real * np.exp(1.1j))
    np.testing.assert_allclose(np.abs(rotated.real), np.abs(real), rtol=1e-12)
    np.testing.assert_allclose(rotated.imag, 0.0, atol=1e-15)


def test_rayleigh_curve_gives_the_papers_prediction():
    # Table 2's two lowest modes predict these for modes 3 to 5 (in percent, to the digits of alpha and beta).
    predicted = rayleigh_damping_ratio(np.array([26.84, 53.20, 88.60]), 0.2282, 3.18e-5)
    np.testing.assert_allclose(100.0 * predicted, [0.336, 0.566, 0.906], atol=1e-3)


def test_slope_and_its_standard_deviation_are_those_of_scipy():
    rng = np.random.default_rng(4)
    x = rng.uniform(0.0, 3.0, 9)
    y = 2.0 - 0.7 * x + 0.1 * rng.standard_normal(9)
    expected = linregress(x, y)
    # Rounding errors alone differ.
    assert line_slope(x, y) == pytest.approx((expected.slope, expected.stderr), rel=1e-10)
