"""Residual checks pass for the true model and fail for a wrong one."""

from dataclasses import replace

import numpy as np
import pytest
from kit.identified import quick
from kit.series import one_mode, pole_of, series_of

from modal_id.modes import residual_checks

LINE, MEMORY, DRIFT, SCORE, TAILS = range(5)


def checks(values, time_s, max_modes=1):
    found = quick(series_of(time_s, values), max_modes=max_modes, onset_s=0.0)
    return residual_checks(found), found


def test_p_values_are_uniform_where_the_model_is_true():
    found = [
        checks(one_mode(2, seed, fps=500.0, duration_s=2.0)[0].values[:, 0], np.arange(1000) / 500.0)[0]
        for seed in range(8)
    ]
    p = np.array([[one.p_value for one in row] for row in found])
    assert np.count_nonzero(p <= 0.01) <= 3, "binomial(40, 0.01) exceeds 3 with probability 7e-4"
    assert 0.32 < np.mean(p) < 0.68, "mean of 40 uniform values: sd 0.046, doubled by dependence in a record"


@pytest.mark.parametrize(
    ("what", "which"), [("neighbour", LINE), ("memory", MEMORY), ("amplitude", SCORE), ("outliers", TAILS)]
)
def test_a_wrong_model_is_detected(what, which):
    series, sd = one_mode(2, 1, duration_s=4.0, ar=0.5 if what == "memory" else 0.0)
    t, y = series.time_s, series.values[:, 0].copy()
    rng = np.random.default_rng(5)
    if what == "neighbour":
        y += 0.01 * np.exp(pole_of(53.2, 0.0023) * t).real
    if what == "amplitude":
        pole = pole_of(26.84, 0.0028)
        size = np.exp(pole.real * t)
        # zeta rises by 30 % at the largest amplitude.
        y = size / (1.0 + 0.3 * (1.0 - size)) * np.cos(pole.imag * t) + sd * rng.standard_normal(t.size)
    if what == "outliers":
        # Below the rejection limit of 5 sd.
        hit = rng.random(t.size) < 0.02
        y[hit] += rng.choice([-1.0, 1.0], hit.sum()) * 4.0 * sd
    found, _ = checks(y, t)
    assert not found[which].holds, found[which]
    if what == "neighbour":
        # Bins of 1 / 4 s.
        assert found[LINE].frequency_hz == pytest.approx(53.2, abs=0.25)
    assert np.isnan(found[TAILS].frequency_hz)


def test_drift_is_detected():
    series, _ = one_mode(2, 1, duration_s=4.0)
    y = series.values[:, 0] + 0.01 * np.sin(2.0 * np.pi * 2.2 * series.time_s)
    found, _ = checks(y, series.time_s)
    assert not found[DRIFT].holds


def test_checks_are_reproducible_and_none_without_modes():
    series, _ = one_mode(2, 1, duration_s=2.0)
    first, found = checks(series.values[:, 0], series.time_s)
    assert residual_checks(found) == first
    assert residual_checks(replace(found, modes=())) == ()
