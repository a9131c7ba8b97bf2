"""Clipped peaks of a vibration, and levels that are no clipping."""

import numpy as np
import pytest
from kit.series import decay

from modal_id.data import last_saturated_row

T = np.arange(4000) / 500.0
NOISE = 0.001 * np.random.default_rng(1).standard_normal(T.size)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_last_clipped_peak_is_found(sign):
    """Amplitude 2 at the start and a limit of 1: the peaks are clipped until the envelope falls below 1."""
    envelope_at_limit_s = np.log(2.0) / (0.01 * 2.0 * np.pi * 8.0)
    y = sign * np.minimum(decay(T, 8.0, 0.01, 2.0, 0.0), 1.0)
    row = last_saturated_row((y + 0.1 * NOISE)[:, None])
    assert row is not None
    assert T[row] == pytest.approx(envelope_at_limit_s, abs=2.0 / 8.0), "within two cycles"


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_level_after_a_step_is_no_clipping(sign):
    y = decay(T, 20.0, 0.05, 1.0, 0.0) + NOISE
    y[3500:] = sign * 1.1 + NOISE[3500:]
    assert last_saturated_row(y[:, None]) is None


def test_uneven_steps_are_no_clipping():
    """Positions of a disc drawn in whole pixels: levels 0.05 to 0.1 apart, with the rounding of their registration."""
    levels = np.cumsum(np.random.default_rng(2).uniform(0.05, 0.1, 14))
    levels = np.concatenate([-levels[::-1], [0.0], levels])
    y = decay(T, 8.0, 0.004, 1.0, 0.0)
    steps = levels[np.argmin(np.abs(y[:, None] - levels), axis=1)] + 1e-5 * NOISE
    assert last_saturated_row(steps[:, None], np.array([1e-5])) is None
