"""Columns whose rows are made when they are needed: against all rows at once, and the memory of a fit with them."""

import numpy as np
import pytest
from scipy.interpolate import BSpline
from support.memory import peak_of

from modal_id.data import FitData, baseline_splines
from modal_id.fit import nonlinear_decay
from modal_id.solve import ModeColumns, Problem, solve_linear

POLES = np.array([-0.01 + 40.0j, -0.02 + 95.0j])
ROWS = [slice(None), slice(4000, 9000), slice(511, 1025), np.array([7, 260_000, 3, 4096])]


@pytest.mark.parametrize("rows", ROWS, ids=["all", "part", "edges", "some"])
@pytest.mark.parametrize("even", [True, False])
def test_rows_of_modes_are_those_of_the_exponential(rows, even):
    """Too many values to be held. A phase of up to 30 000 rad is rounded by 4e-12, even times may miss by 1e-9 rad."""
    time_s = 0.001 * np.arange(300_000)
    time_s = time_s if even else np.sort(time_s + 1e-4 * np.sin(time_s))
    columns = ModeColumns(time_s, POLES)[rows]
    exact = np.exp(time_s[rows, None] * POLES)
    np.testing.assert_allclose(columns, exact.view(float), atol=2e-9)


def test_rows_of_a_nonlinear_decay_do_not_depend_on_which_are_asked_for():
    time_s = np.sort(np.random.default_rng(0).uniform(0.0, 5.0, 20_000))
    for columns in nonlinear_decay(time_s, np.array([0.4, 60.0, 0.15, 0.3])):
        everything, some = columns[:], np.array([9000, 3, 4096, 19_999])
        np.testing.assert_array_equal(columns[4000:9001], everything[4000:9001])
        np.testing.assert_array_equal(columns[some], everything[some])


@pytest.mark.parametrize(("samples", "bandwidth_hz"), [(3000, 0.3), (250_000, 12.0)])
def test_splines_are_those_of_scipy(samples, bandwidth_hz):
    time_s = np.sort(np.random.default_rng(1).uniform(0.0, 37.0, samples))
    splines = baseline_splines(time_s, bandwidth_hz)
    exact = BSpline.design_matrix(time_s, splines.knots, 3)
    some = np.array([samples - 1, 0, 17])
    # Three sums and quotients of numbers up to 1, each rounded.
    for rows in (slice(None), slice(100, 2000), some):
        assert abs(splines[rows] - exact[rows]).max() < 4e-15


def bytes_held(samples):
    """Peak memory of a fit of eight modes in one channel and a baseline, data not included."""
    time_s = 0.001 * np.arange(samples)
    values = np.random.default_rng(2).standard_normal((samples, 1))
    data = FitData(time_s, values, np.ones((samples, 1)))
    poles = -0.01 + 40.0j * np.arange(1.0, 9.0)
    splines = baseline_splines
    return peak_of(lambda: solve_linear(Problem(data, splines(time_s, 0.5)), ModeColumns(time_s, poles)))[0]


def test_a_long_fit_holds_its_residual_but_not_its_columns():
    """A value takes 8 bytes: the residual, and passing ones of the weights. 16 columns take 128, the splines 52."""
    bytes_held(1000)
    more = (bytes_held(500_000) - bytes_held(300_000)) / 200_000
    assert more < 40.0, f"{more:.0f} bytes for a sample; five values at a time are expected at most"
