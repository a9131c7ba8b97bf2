"""Severity of flags follows their effect on the result."""

import numpy as np
import pytest
from kit.identified import quick
from kit.series import pole_of, series_of
from scipy.signal import lfilter

from tracker import Severity


def target_of(time_s, values):
    return quick(series_of(time_s, values), onset_s=0.0, max_modes=2).target


def dependent(zeta_change, frequency_change_hz, noise, seed=0):
    """Decay with zeta = 0.003 + zeta_change a and the frequency 20 Hz + frequency_change_hz a^2."""
    steps = np.arange(0.0, 12.0, 1e-4)
    omega, zeta0 = 2 * np.pi * 20.0, 0.003
    lost = -np.expm1(-zeta0 * omega * steps)
    a = (1.0 - lost) / (1.0 + zeta_change / zeta0 * lost)
    phase = omega * steps + 2 * np.pi * frequency_change_hz * np.cumsum(a**2) * 1e-4
    y = (a * np.cos(phase))[::20]
    return steps[::20], y + noise * np.random.default_rng(seed).standard_normal(y.size)


def test_a_clean_decay_raises_no_flag():
    time_s = np.arange(6000) / 500
    values = np.exp(pole_of(20.0, 0.003) * time_s).real
    target = target_of(time_s, values + 0.003 * np.random.default_rng(0).standard_normal(time_s.size))
    assert {flag: target.severity_of(flag) for flag in target.flags} == {}


def test_a_large_dependence_widens_the_interval():
    target = target_of(*dependent(0.002, -0.05, 0.003))
    assert target.severity_of("AMPLITUDE_DEPENDENT") is Severity.INTERVAL
    assert target.posterior.systematic[1] > 0.5 * target.damping_ratio_sd
    zeta, sd = target.small_amplitude_damping
    assert zeta == pytest.approx(0.003, abs=3.5 * sd)


def test_a_change_of_a_fiftieth_of_a_percent_is_information():
    """0.02 % of the frequency, 2 % of the damping: significant at this noise, of no practical consequence."""
    target = target_of(*dependent(6e-5, 0.004, 2e-4))
    assert target.severity_of("AMPLITUDE_DEPENDENT") is Severity.INFORMATION
    f, f_sd = target.small_amplitude_frequency
    # sqrt(1 - zeta^2) is 1 - 4.5e-6.
    assert f == pytest.approx(20.0 * (1.0 + 4.5e-6), abs=3.5 * f_sd)


def test_a_pendulum_that_hardly_decays_has_one_flag_about_it():
    time_s = np.arange(3600) / 60
    values = np.exp(pole_of(0.9758, 1e-4) * time_s).real
    target = target_of(time_s, values + 0.01 * np.random.default_rng(0).standard_normal(time_s.size))
    assert "DAMPING_TOUCHES_ZERO" not in target.flags
    assert target.severity_of("FEW_CYCLES_LOST") is Severity.INTERVAL
    low, high = target.damping_interval(0.99)
    assert low < 1e-4 < high


def excited_during_decay(seed):
    """The mode of 20 Hz decays from 1 while random forces move it with an rms of 0.05: not a free decay."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(1200) / 150.0
    step = np.exp(pole_of(20.0, 0.003) / 150.0)
    force = rng.standard_normal(time_s.size) + 1j * rng.standard_normal(time_s.size)
    moved = lfilter([1.0], [1.0, -step], force)
    moved *= 0.05 / np.sqrt(0.5 / (1.0 - abs(step) ** 2)) / np.sqrt(2.0)
    decay = np.exp(pole_of(20.0, 0.003) * time_s)
    return time_s, (decay + moved).real + 1e-3 * rng.standard_normal(time_s.size)


@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (0, 2))])
def test_motion_that_is_no_free_decay_is_flagged_and_wide(seed):
    target = target_of(*excited_during_decay(seed))
    raised = {flag: target.severity_of(flag) for flag in target.flags}
    assert any(severity is not Severity.INFORMATION for severity in raised.values()), raised
    low, high = target.damping_interval(0.999)
    assert low < 0.003 < high, f"zeta {target.damping_ratio:.5f}, sd {target.damping_ratio_sd:.5f}, {raised}"
    assert abs(target.frequency_hz - 20.0) < 4.0 * target.frequency_sd_hz, raised
