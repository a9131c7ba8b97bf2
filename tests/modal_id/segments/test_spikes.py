"""Single samples far from the motion about them, and plucks, stops and steps, which are none."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from kit.series import decay

from modal_id.data import FitData
from modal_id.segments import without_spikes

NOISE = 0.02


def removed(t, y, frequency_hz):
    data = FitData(t, y[:, None], np.ones((t.size, 1)))
    return np.flatnonzero(without_spikes(data, frequency_hz).weights[:, 0] == 0.0)


@pytest.mark.parametrize("per_cycle", [4.0, 12.0, 40.0])
def test_single_samples_are_removed_and_no_others(per_cycle):
    rng = np.random.default_rng(0)
    t = np.arange(1000) / (per_cycle * 10.0)
    y = decay(t, 10.0, 0.005, 1.0, 0.3) + NOISE * rng.standard_normal(t.size)
    # At least half a window of the fewest samples apart, so that none hides another.
    hit = 20 * rng.choice(50, 12, replace=False) + 5
    y[hit] += rng.choice([-1.0, 1.0], hit.size) * rng.uniform(0.5, 3.0, hit.size)
    assert set(removed(t, y, 10.0)) == set(hit), "each is 25 or more standard deviations from the motion"


@settings(max_examples=20, derandomize=True, deadline=None)
@given(at=st.integers(60, 140), size=st.floats(0.3, 3.0), seed=st.integers(0, 9))
def test_an_event_is_not_removed(at, size, seed):
    """Wherever between two windows a pluck or a step lies, it disturbs more than a tenth of one of them.

    At most the two samples beside it go with it, a tenth of a window of 24.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(400) / 120.0
    noise = NOISE * rng.standard_normal(t.size)
    pluck = np.where(np.arange(t.size) < at, 0.0, size * np.cos(2 * np.pi * 10.0 * (t - t[at])))
    step = decay(t, 10.0, 0.005, 1.0, 0.3) + np.where(np.arange(t.size) < at, 0.0, size)
    for y in (pluck, step):
        assert np.all(np.abs(removed(t, y + noise, 10.0) + 0.5 - at) < 2.0)
