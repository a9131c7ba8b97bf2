"""The error of the frame rate in the intervals of frequencies."""

from dataclasses import replace

import numpy as np
import pytest
from kit.series import PAPER_HZ, PAPER_ZETA, pole_of, series_of

from modal_id import IdentifySettings, identify

PPM = 1000.0
MODES = (1, 2)


@pytest.fixture(scope="module")
def decay():
    """Two modes of the paper's beam at 1000 fps, 50 dB."""
    t = np.arange(4000) / 1000.0
    rng = np.random.default_rng(3)
    motion = sum(np.exp(pole_of(PAPER_HZ[m], PAPER_ZETA[m]) * t).real for m in MODES)
    return series_of(t, motion + 0.003 * rng.standard_normal(t.size))


def identified(series, ppm):
    found = identify(replace(series, rate_sd_ppm=ppm), IdentifySettings(seed=1))
    assert len(found.modes) == len(MODES)
    return found


def test_a_rate_that_is_wrong_within_its_tolerance_is_in_the_interval(decay):
    """By 2.5 sd of the rate: about as many sd of the frequency, since the record determines it far better."""
    stretched = replace(decay, time_s=decay.time_s * (1.0 + 2.5e-6 * PPM))
    exact, stated = identified(stretched, 0.0), identified(stretched, PPM)
    for k, m in enumerate(MODES):
        off = abs(exact.modes[k].frequency_hz - PAPER_HZ[m])
        assert off > 20.0 * exact.modes[k].frequency_sd_hz, "a record determines its frequencies to 1e-5"
        sd = stated.modes[k].frequency_sd_hz
        # 2.5 sd of the rate, less what the error of the record itself can change
        assert 2.3 < off / sd < 2.7
        own = exact.modes[k].frequency_sd_hz
        expected = np.hypot(own, 1e-6 * PPM * PAPER_HZ[m])
        assert sd == pytest.approx(expected, rel=0.02), "independent errors add up by their squares"
        assert stated.modes[k].damping_ratio == exact.modes[k].damping_ratio
        assert stated.modes[k].damping_ratio_sd == exact.modes[k].damping_ratio_sd
    assert "1000 ppm" in stated.notes[-1]
    assert not any("ppm" in note for note in exact.notes)


def test_the_error_is_common_to_all_modes(decay):
    """The ratio of two frequencies does not depend on the rate."""
    exact, stated = identified(decay, 0.0), identified(decay, PPM)

    def ratio(found):
        first, second = (mode.posterior.frequency_hz for mode in found.modes)
        return first / second

    np.testing.assert_allclose(ratio(stated), ratio(exact), rtol=1e-12)
    for one, other in zip(stated.modes, exact.modes, strict=True):
        np.testing.assert_allclose(
            one.posterior.frequency_in_record_hz, other.posterior.frequency_hz, rtol=1e-12
        )
        low, high = one.frequency_interval_hz()
        # 90 % of a normal distribution lie within 1.645 sd
        assert high - low == pytest.approx(2.0 * 1.645 * one.frequency_sd_hz, rel=0.03)


def test_the_frequency_of_a_driven_motion_has_the_error_too():
    t = np.arange(3000) / 1000.0
    drive = np.cos(2.0 * np.pi * 26.765 * t) + 0.01 * np.random.default_rng(5).standard_normal(t.size)
    own, stated = (identify(replace(series_of(t, drive), rate_sd_ppm=ppm)).driven[0] for ppm in (0.0, PPM))
    expected = np.hypot(own.frequency_sd_hz, 1e-6 * PPM * own.frequency_hz)
    assert expected > 5.0 * own.frequency_sd_hz, "the record determines the frequency better than the rate"
    assert stated.frequency_sd_hz == pytest.approx(expected, rel=1e-12), "independent errors add by squares"


def test_the_limit_at_small_amplitude_has_the_error_too(decay):
    dependence = identified(decay, PPM).modes[0].amplitude_dependence
    own = identified(decay, 0.0).modes[0].amplitude_dependence
    assert dependence.f0_sd_hz == pytest.approx(np.hypot(own.f0_sd_hz, 1e-6 * PPM * own.f0_hz), rel=1e-12)
