"""A weak mode beside a strong one whose damping depends on the amplitude, and modes of which nothing is left."""

import numpy as np
import pytest
from kit.series import decay, of_amplitude, series_of

from modal_id import identify

RATE_HZ, SPAN_S = 500.0, 40.0
STRONG_HZ, WEAK_HZ, WEAK_ZETA = 5.2, 14.5, 0.0265


def record(growth, seed):
    """zeta = 4e-4 (1 + growth a^2) at 5.2 Hz, and a constant damping ratio at 14.5 Hz, of a quarter of its size."""
    rng = np.random.default_rng(seed)
    t = np.arange(int(SPAN_S * RATE_HZ)) / RATE_HZ
    strong = of_amplitude(t.size, 1 / RATE_HZ, lambda a: (4e-4 * (1.0 + growth * a**2), STRONG_HZ), 1.0, 0.3)
    values = strong + decay(t, WEAK_HZ, WEAK_ZETA, 0.26)
    return series_of(t, values[:, None] + 7e-4 * rng.standard_normal((t.size, 1)))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_weak_mode_does_not_take_over_the_dependence_of_a_strong_one(seed):
    plain, bent = (identify(record(growth, seed)) for growth in (0.0, 0.6))
    weak, reference = (min(r.modes, key=lambda m: abs(m.frequency_hz - WEAK_HZ)) for r in (bent, plain))
    strong = max(bent.modes, key=lambda m: m.amplitude)
    assert "AMPLITUDE_DEPENDENT" in strong.flags
    assert "AMPLITUDE_DEPENDENT" not in weak.flags, "its damping ratio is constant"
    zeta, sd = weak.small_amplitude_damping
    assert abs(zeta - WEAK_ZETA) < 3.0 * sd, "3 sd of a normal error"
    assert weak.damping_ratio_sd < 1.5 * reference.damping_ratio_sd, "as much is known of it as without"


def test_a_mode_of_which_nothing_is_left_has_its_limits():
    # after 900 decay times
    t = np.arange(60000) / RATE_HZ
    values = decay(t, 10.0, 0.12) + 1e-3 * np.random.default_rng(1).standard_normal(t.size)
    (mode,) = identify(series_of(t, values[:, None])).modes
    frequency, sd = mode.small_amplitude_frequency
    assert abs(frequency - 10.0) < 3.0 * sd, "3 sd of a normal error"


@pytest.mark.parametrize("slow", [0.3, 0.0])
def test_a_misfit_of_the_first_seconds_does_not_vanish_in_a_long_record(slow):
    # The second motion is as slow as a drift of the first may be: the baseline takes part of it.
    t = np.arange(3000) / 7.3
    values = decay(t, 1.843, 0.166) + decay(t, 0.662, 0.05, slow, 1.2)
    noise = 2e-3 * np.random.default_rng(5).standard_normal(t.size)
    found = identify(series_of(t, (values + noise)[:, None]))
    mode = min(found.modes, key=lambda m: abs(m.frequency_hz - 1.843))
    assert abs(mode.frequency_hz - 1.843) < 4.0 * mode.frequency_sd_hz, "the bias is part of the interval"
    assert ("RESIDUAL_AT_MODE" in mode.flags) == (slow > 0.0)
