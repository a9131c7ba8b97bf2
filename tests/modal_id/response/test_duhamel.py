"""Response to a sampled input against `scipy.integrate` and closed forms."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from modal_id.response import drive

POLE = -0.9 + 62.0j


@pytest.mark.parametrize("even", [True, False])
def test_the_response_to_a_spline_is_that_of_a_solver(even: bool) -> None:
    generator = np.random.default_rng(1)
    time_s = np.linspace(0.0, 1.0, 201)
    if not even:
        time_s = np.sort(generator.uniform(0.0, 1.0, 201))
    values = np.sin(20.0 * time_s) + 0.3 * np.cos(47.0 * time_s)
    spline = CubicSpline(time_s, values)

    def slope(t: float, z: np.ndarray) -> np.ndarray:
        return POLE * z + spline(t)

    limits = (time_s[0], time_s[-1])
    exact = solve_ivp(slope, limits, [0.0 + 0.0j], "DOP853", time_s, rtol=1e-11, atol=1e-13, max_step=0.01)
    found = drive(time_s, values).response(POLE)
    # Third derivatives of the spline jump at its knots: the solver, not the sum of exact integrals, is limited.
    np.testing.assert_allclose(found, exact.y[0], atol=1e-8, err_msg="from the tolerance of the solver")


def test_a_sinusoid_is_answered_as_by_the_transfer_function() -> None:
    rate_hz, at_hz = 500.0, 9.0
    time_s = np.arange(4000) / rate_hz
    s = 2j * np.pi * at_hz
    exact = np.imag(np.exp(s * time_s))
    found = drive(time_s, exact).response(POLE)
    up, down = 1.0 / (s - POLE), 1.0 / (-s - POLE)
    steady = (up * np.exp(s * time_s) - down * np.exp(-s * time_s)) / 2j
    steady -= steady[0] * np.exp(POLE * time_s)
    error = np.max(np.abs(found - steady)) / np.max(np.abs(steady))
    # A cubic spline loses (w h)^4 / 720 of a sinusoid in its interior; its ends add as much again.
    limit = 10.0 * (2.0 * np.pi * at_hz / rate_hz) ** 4 / 720.0
    assert error < limit, f"relative error {error:.2g}, the spline's is below {limit:.2g}"


def test_the_slope_is_the_derivative_along_both_axes() -> None:
    time_s = np.arange(500) / 250.0
    given = drive(time_s, np.random.default_rng(3).standard_normal(500))
    for turn in (1.0, 1j):
        step = 1e-3 * turn
        secant = (given.response(POLE + step) - given.response(POLE - step)) / (2.0 * step)
        # The third derivative of exp(lambda t) over 2 s, times step^2 / 6, relative to the first.
        np.testing.assert_allclose(
            given.slope(POLE),
            secant,
            atol=1e-5 * np.max(np.abs(secant)),
            err_msg="from the remainder of the secant",
        )


def test_missing_input_is_taken_from_the_spline() -> None:
    time_s = np.arange(400) / 200.0
    values = np.sin(2.0 * np.pi * 3.0 * time_s)
    gaps = values.copy()
    gaps[[50, 51, 120]] = np.nan
    whole, with_gaps = (drive(time_s, v).response(POLE) for v in (values, gaps))
    # Interpolation across three steps of 5 ms at 3 Hz: (w 3 h)^4 / 384, over a response of 1 / |i w - lambda|.
    limit = (2.0 * np.pi * 3.0 * 0.015) ** 4 / 384.0 / 40.0
    assert np.max(np.abs(whole - with_gaps)) < limit, "from the error of a cubic spline across the gap"
