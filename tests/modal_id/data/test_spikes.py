"""Single samples far from the motion about them, and plucks, stops and steps, which are none."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from kit.series import decay, series_of

from modal_id import identify
from modal_id.data import FitData, without_spikes

NOISE = 0.02


def removed(t, y):
    data = FitData(t, y[:, None], np.ones((t.size, 1)))
    return np.flatnonzero(without_spikes(data).weights[:, 0] == 0.0)


@pytest.mark.parametrize("per_cycle", [4.0, 12.0, 40.0])
def test_single_samples_are_removed_and_no_others(per_cycle):
    rng = np.random.default_rng(0)
    t = np.arange(1000) / (per_cycle * 10.0)
    y = decay(t, 10.0, 0.005, 1.0, 0.3) + NOISE * rng.standard_normal(t.size)
    # Further apart than the samples on either side of an interpolation, so that none enters that of another.
    hit = 20 * rng.choice(50, 12, replace=False) + 10
    y[hit] += rng.choice([-1.0, 1.0], hit.size) * rng.uniform(0.5, 3.0, hit.size)
    assert set(removed(t, y)) == set(hit), "each is 25 or more standard deviations from the motion"


@pytest.mark.parametrize("count", [1, 2, 8, 9, 24, 25, 41])
def test_few_samples_have_no_spikes(count):
    """As many as a part of a record may have: too few to tell how well one is interpolated, or noise alone."""
    y = NOISE * np.random.default_rng(count).standard_normal(count)
    assert not removed(np.arange(float(count)), y).size


@settings(max_examples=40, derandomize=True, deadline=None)
@given(at=st.integers(60, 340), size=st.floats(0.3, 3.0), seed=st.integers(0, 9))
def test_an_event_is_not_removed(at, size, seed):
    """More samples than one leave the motion before it; noise may hide that of a sample or two at its edges."""
    rng = np.random.default_rng(seed)
    t = np.arange(400) / 120.0
    noise = NOISE * rng.standard_normal(t.size)
    pluck = np.where(np.arange(t.size) < at, 0.0, size * np.cos(2 * np.pi * 10.0 * (t - t[at])))
    step = decay(t, 10.0, 0.005, 1.0, 0.3) + np.where(np.arange(t.size) < at, 0.0, size)
    click = step - np.where(np.arange(t.size) < at + 6, 0.0, size)
    for y in (pluck, step, click):
        assert removed(t, y + noise).size <= 2


@pytest.mark.parametrize("seed", range(3))
def test_a_strongly_damped_decay_among_outliers_is_found(seed):
    """Its motion is gone after a tenth of the record; in all of it, 3 % of the samples are as large as its beginning.

    A spectrum of all samples has no line. Tolerance: five standard deviations of the answer, and .1 % and 1 % at 60 dB.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(2000) / 300.0
    y = decay(t, 13.0, 0.108, 1.0, 0.3) + 0.001 * rng.standard_normal(t.size)
    hit = rng.choice(t.size, 60, replace=False)
    y[hit] += rng.choice([-1.0, 1.0], hit.size) * rng.uniform(0.5, 3.0, hit.size)
    found = identify(series_of(t, y))
    assert found, found.reason
    mode = found.target
    assert abs(mode.frequency_hz - 13.0) < min(5.0 * mode.frequency_sd_hz, 0.013)
    assert abs(mode.damping_ratio - 0.108) < min(5.0 * mode.damping_ratio_sd, 0.00108)
