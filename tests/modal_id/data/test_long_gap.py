"""Pauses much longer than everything recorded: memory does not grow with them."""

import numpy as np
import pytest
from kit.identified import quick
from kit.series import pole_of, series_of
from support.memory import peak_of

from modal_id.data import longest_without_pause

RATE_HZ, FREQUENCY_HZ, ZETA = 500.0, 10.0, 0.01


def paused(pause_s, rows, of):
    time_s = np.arange(of) / RATE_HZ
    time_s[rows:] += pause_s
    return time_s


def test_a_pause_of_hours_leaves_the_longer_part_in_little_memory():
    time_s = paused(1e4, 100, 700)
    rng = np.random.default_rng(1)
    motion = np.exp(pole_of(FREQUENCY_HZ, ZETA) * np.r_[time_s[:100], time_s[100:] - time_s[100]]).real
    series = series_of(time_s, motion + 0.01 * rng.standard_normal(time_s.size))
    peak, found = peak_of(lambda: quick(series))
    assert found, found.reason
    assert abs(found.target.frequency_hz - FREQUENCY_HZ) < 4.0 * found.target.frequency_sd_hz
    assert "pauses for 1e+04 s: only the 600 samples" in " ".join(found.notes)
    # A grid over the pause has 5e6 steps: 40 MB for each array of a channel.
    assert peak < 40e6, f"peak of {peak / 1e6:.0f} MB, less than one array over the pause of 40 MB expected"


@pytest.mark.parametrize("pause_s", [0.01, 1.0, 5.0])
def test_a_pause_like_those_between_plucks_is_kept(pause_s):
    assert longest_without_pause(paused(pause_s, 300, 700)) is None
