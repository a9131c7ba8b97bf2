"""Changes of a motion located from both sides, compared with the sample at which they were made."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from modal_id.data import FitData
from modal_id.segments import locate_boundary

HZ, RATE_HZ, CHANGE = 10.0, 120.0, 300
ROWS = np.arange(600)
T, AFTER = ROWS / RATE_HZ, ROWS >= CHANGE
MODES = ((HZ, 0.01, 1.0), (2.7 * HZ, 0.004, 0.3))


def free(since, rng, zeta=None):
    return sum(
        a
        * np.exp(-(zeta or z) * 2 * np.pi * f * since)
        * np.cos(2 * np.pi * f * since + rng.uniform(0, 2 * np.pi))
        for f, z, a in MODES
    )


def plucked(rng):
    """Another pluck at row CHANGE."""
    return np.where(AFTER, free(T - T[CHANGE], rng), free(T, rng))


def held(rng):
    """The motion of one mode goes on with twenty times the damping from row CHANGE on."""
    rate = 2 * np.pi * HZ * np.where(AFTER, 0.08, 0.004)
    lost = np.concatenate([[0.0], np.cumsum(rate[:-1]) / RATE_HZ])
    return np.exp(-lost) * np.cos(2 * np.pi * HZ * T + rng.uniform(0, 2 * np.pi))


def released(rng):
    """Rest until row CHANGE."""
    return np.where(AFTER, free(T - T[CHANGE], rng), 0.0)


def located(values, weights=None, *, off=6):
    """Boundary with rough limits that many rows on either side of a place half a cycle from the change."""
    weights = np.ones((values.size, 1)) if weights is None else weights
    data = FitData(T, np.where(weights > 0.0, values[:, None], 0.0), weights)
    middle = CHANGE + off
    limits = T[middle - 12], T[middle + 12]
    return locate_boundary(data, 0.0, limits, float(T[-1]), 1.0 / HZ, 0.0)


@pytest.mark.parametrize("motion", [plucked, released])
@pytest.mark.parametrize("off", [-6, 0, 6])
def test_a_pluck_is_located_to_the_sample(motion, off):
    for seed in range(5):
        rng = np.random.default_rng([seed, off + 6])
        values = motion(rng) + 2e-3 * rng.standard_normal(T.size)
        found = located(values, off=off)
        # Two motions with a common phase agree for a sample or two: differences of 1 % of the amplitude are five sd.
        assert abs(found.start_s - T[CHANGE]) <= 2.5 / RATE_HZ, (seed, found)
        assert T[CHANGE] - 3.5 / RATE_HZ <= found.end_s <= found.start_s, (seed, found)


@pytest.mark.parametrize("count", [12, pytest.param(200, marks=pytest.mark.slow)])
def test_the_time_at_which_a_hand_grips_is_as_uncertain_as_stated(count):
    """At the change, amplitude and phase are continuous: only what follows shows it."""
    z = []
    for seed in range(count):
        rng = np.random.default_rng([seed, 77])
        found = located(held(rng) + 0.03 * rng.standard_normal(T.size))
        z.append((0.5 * (found.start_s + found.end_s) - T[CHANGE]) / found.sd_s)
    rms = float(np.sqrt(np.mean(np.square(z))))
    low, high = np.sqrt(chi2.ppf([5e-4, 1.0 - 5e-4], count) / count)
    # The sd is that of known motions; those of both sides are fitted, at most as uncertain again.
    assert low < rms < high * np.sqrt(2.0), (rms, z)


@settings(max_examples=15, deadline=None)
@given(st.floats(-4.0, 4.0), st.floats(-100.0, 100.0))
def test_unit_and_offset_do_not_matter(log_scale, offset):
    rng = np.random.default_rng(3)
    values = plucked(rng) + 0.01 * rng.standard_normal(T.size)
    one, other = located(values), located(10.0**log_scale * (values + offset))
    assert (one.start_s, one.end_s) == pytest.approx((other.start_s, other.end_s), abs=0.5 / RATE_HZ)


def test_a_change_within_a_gap_is_at_its_ends():
    rng = np.random.default_rng(0)
    weights = np.where(np.abs(ROWS - CHANGE) < 8, 0.0, 1.0)[:, None]
    found = located(plucked(rng) + 2e-3 * rng.standard_normal(T.size), weights, off=0)
    # one sample may agree with both motions by chance
    assert found.end_s in (T[CHANGE - 9], T[CHANGE - 8], T[CHANGE + 8])
    assert found.start_s in (T[CHANGE - 8], T[CHANGE + 8], T[CHANGE + 9])


def test_where_nothing_can_be_fitted_there_is_no_boundary():
    data = FitData(T[:20], np.zeros((20, 1)), np.ones((20, 1)))
    assert locate_boundary(data, 0.0, (T[9], T[10]), float(T[19]), 1.0, 0.0) is None
