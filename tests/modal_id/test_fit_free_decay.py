"""Modes of decays without noise, against the values that generated them."""

from dataclasses import replace

import numpy as np
import pytest
from kit.series import series_of

from modal_id import fit_free_decay
from tracker import Failure

TIME_S = np.arange(0.0, 2.0, 1.0 / 250.0)


def series(*waves):
    """Motion of two channels, the second half as large, that begins at 3 s."""
    values = np.outer(sum(np.real(wave) for wave in waves), [1.0, 0.5])
    return series_of(3.0 + TIME_S, values, "mm", positions_mm=np.array([100.0, 200.0]))


def wave(amplitude, frequency_hz, damping_ratio):
    omega = 2.0 * np.pi * frequency_hz
    return amplitude * np.exp((-damping_ratio + 1j * np.sqrt(1.0 - damping_ratio**2)) * omega * TIME_S)


def test_two_modes_are_those_that_were_added():
    found = fit_free_decay(series(wave(2.0, 10.0, 0.004), wave(0.3, 26.0, 0.006)), max_modes=2)
    values = [(m.frequency_hz, m.damping_ratio, m.amplitude) for m in found]
    # The sum is the model itself: what is left is the offset that is fitted beside it, and rounding.
    np.testing.assert_allclose(
        sorted(values), [(10.0, 0.004, 2.0), (26.0, 0.006, 0.3)], rtol=1e-5, err_msg="exact sum of two decays"
    )
    assert all(abs(m.frequency_shift) < 1e-6 for m in found), "the frequencies are constant"


@pytest.mark.parametrize("shift", [-2e-3, 3e-3])
def test_a_frequency_that_grows_with_the_square_of_the_amplitude_has_its_shift(shift):
    omega, decay = 2.0 * np.pi * 20.0, 1.5
    # the integral of omega (1 + shift a^2) with a = exp(-decay t)
    phase = omega * (TIME_S + shift * (1.0 - np.exp(-2.0 * decay * TIME_S)) / (2.0 * decay))
    (mode,) = fit_free_decay(series(np.exp(-decay * TIME_S + 1j * phase)), max_modes=1)
    # The model is the law that generated the motion; its step of integration and the offset leave less than a percent.
    assert mode.frequency_shift == pytest.approx(shift, rel=0.01)


def test_a_record_that_is_too_short_is_a_reason():
    short = series(wave(1.0, 10.0, 0.004))
    found = fit_free_decay(
        replace(short, time_s=short.time_s[:5], values=short.values[:5], sd=short.sd[:5]), max_modes=1
    )
    assert isinstance(found, Failure)
    assert found.reason
