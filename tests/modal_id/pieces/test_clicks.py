"""Clicks within a decay: what lies together among the rejected samples, and fades."""

import numpy as np
import pytest
from kit.series import pole_of

from modal_id.data import FitData
from modal_id.fit import find_modes
from modal_id.pieces import click_segments, without_clicks

RATE_HZ, CHANNELS = 2000.0, 2
TIME_S = np.arange(8000) / RATE_HZ


def record(seed, *, slope=0.0):
    """A decay of 20 Hz in noise of a hundredth; zeta = 0.003 (1 + slope a)."""
    rng = np.random.default_rng(seed)
    lost = -np.expm1(pole_of(20.0, 0.003).real * TIME_S)
    motion = (1.0 - lost) / (1.0 + slope * lost) * np.cos(2.0 * np.pi * 20.0 * TIME_S)
    return motion[:, None] * np.ones(CHANNELS) + 0.01 * rng.standard_normal((TIME_S.size, CHANNELS))


def fitted(values):
    data = FitData(TIME_S, values, np.ones(values.shape))
    model = find_modes(data, 4)
    return model, *without_clicks(model, data.weights)


def spread_outliers(values, share, seed=1):
    rng = np.random.default_rng(seed)
    bad = rng.random(TIME_S.size) < share
    values[bad] += 3.0 * rng.standard_normal((np.count_nonzero(bad), 1))


@pytest.mark.parametrize("share", [0.0, 0.01])
def test_a_click_is_left_out_with_what_fades_after_it(share):
    values = record(2)
    spread_outliers(values, share)
    since = TIME_S - 1.5
    # 1 falls below the noise of 0.01 after 4.6 times 5 ms.
    values[since > 0.0] += (np.exp(-since / 0.005) * np.sign(np.sin(2.0 * np.pi * 600.0 * since)))[
        since > 0.0, None
    ]
    before, after, rows = fitted(values)
    (click,) = click_segments(TIME_S, rows)
    assert click.kind == "disturbed"
    assert 1.499 < click.start_s < 1.502
    assert 1.5 + 0.012 < click.end_s < 1.5 + 0.026
    assert np.all(after.data.weights[rows] == 0.0)
    outside = ~rows
    assert np.array_equal(after.data.weights[outside] > 0.0, before.data.weights[outside] > 0.0)


@pytest.mark.parametrize("share", [0.002, 0.05])
def test_single_outliers_are_no_click(share):
    values = record(3)
    spread_outliers(values, share)
    before, after, rows = fitted(values)
    assert np.count_nonzero(before.data.weights == 0.0) > 0.5 * share * values.size
    assert not rows.any()
    assert after is before


def test_motion_that_a_constant_damping_ratio_lacks_is_no_click():
    """The residual of the first cycles is many times the noise, in every cycle."""
    before, after, rows = fitted(record(4, slope=3.0))
    assert float(np.max(np.abs(before.fit.linear.residual[:400]))) > 0.1
    assert not rows.any()
    assert after is before


def test_the_fault_of_one_of_three_channels_is_no_click():
    values = np.column_stack([record(5), record(6)[:, 0]])
    values[3000:3030, 1] += 5.0
    before, _, rows = fitted(values)
    assert np.all(before.data.weights[3000:3030, 1] == 0.0)
    assert not rows.any()
