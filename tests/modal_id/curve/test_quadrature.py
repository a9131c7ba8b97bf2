"""Decay of a law by quadrature, compared with the closed form and with an adaptive integrator."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from modal_id.curve import PowerLaw, SaturatingLaw, SplineLaw, decay_of_law, wave_of_law
from modal_id.fit import nonlinear_decay

TIME_S = np.append(0.0, np.sort(np.random.default_rng(0).uniform(0.0, 18.0, 3000)))
# Steps of u = ln a are h = 1.5 decay T / 800; the trapezoidal rule and linear interpolation err by at most about
# h^2 / 8 times the second derivative of u and phase by u, below 2 here: 1e-4.
TOLERANCE = 1e-4

SPLINE = SplineLaw(7, 0.3, 1.2, 0.05)
AT = np.linspace(0.0, 1.0, SPLINE.knots)
CASES = [
    (PowerLaw((1.0, 2.0), 1.0, 1.0), np.array([0.2, 60.0, 0.1, 0.3])),
    (PowerLaw((), 1.0, 1.0), np.array([0.2, 60.0])),
    (SaturatingLaw(1.0, 1.0, 0.01), np.array([0.17, 58.9, 0.14, 0.27, -2.4, -2.1, 0.7, 1.2])),
    (SPLINE, SPLINE.parameters(0.18 + 0.1 * AT**2, 59.0 + 0.2 * np.sin(2.0 * AT))),
]
IDS = ["power", "constant", "saturating", "spline"]


def test_linear_law_has_the_closed_form():
    law, parameters = CASES[0]
    exact = nonlinear_decay(TIME_S, parameters)[0][:].view(complex)[:, 0]
    found = decay_of_law(TIME_S, law, parameters)
    # The closed form integrates its phase by the trapezoidal rule over 6 ms.
    np.testing.assert_allclose(found.wave, exact, atol=TOLERANCE)
    np.testing.assert_array_equal(found.wave, wave_of_law(TIME_S, law, parameters))


@pytest.mark.parametrize(("law", "parameters"), CASES[2:], ids=IDS[2:])
def test_other_laws_agree_with_an_adaptive_integrator(law, parameters):
    def slopes(_, y):
        rates = law.rates(np.exp(y[:1]), parameters)
        return [-rates.decay[0], rates.angular[0] - parameters[1]]

    exact = solve_ivp(slopes, (0.0, 18.0), [0.0, 0.0], t_eval=TIME_S, rtol=1e-9, atol=1e-10).y
    wave = np.exp(exact[0] + 1j * (exact[1] + parameters[1] * TIME_S))
    np.testing.assert_allclose(wave_of_law(TIME_S, law, parameters) / wave, 1.0, atol=TOLERANCE)


@pytest.mark.parametrize(("law", "parameters"), CASES, ids=IDS)
def test_derivatives(law, parameters):
    found = decay_of_law(TIME_S, law, parameters)
    for i in range(parameters.size):
        up, down = parameters.copy(), parameters.copy()
        up[i] += 1e-4
        down[i] -= 1e-4
        waves = [decay_of_law(TIME_S, law, p).wave for p in (up, down)]
        numeric = (waves[0] - waves[1]) / 2e-4
        # Between the points of the quadrature, h = 0.01 apart in ln a, the derivative of the interpolated wave has
        # steps of h / 2 of its own.
        scale = np.max(np.abs(numeric))
        np.testing.assert_allclose(found.slopes[:, i], numeric, atol=5e-3 * scale, err_msg=f"parameter {i}")


def test_rates_above_the_reach_of_the_record_may_be_negative():
    """decay(a) = 0.2 a - 0.01 reaches zero at a = 0.05, to which the amplitude falls without passing it."""
    law = PowerLaw((1.0, 1.0), 1.0, 1.0)
    parameters = np.array([-0.01, 60.0, 0.2, 0.0])
    found = wave_of_law(TIME_S, law, parameters)
    exact = nonlinear_decay(TIME_S, parameters)[0][:].view(complex)[:, 0]
    np.testing.assert_allclose(np.abs(found), np.abs(exact), rtol=1e-3)
    assert wave_of_law(TIME_S, law, np.array([-0.3, 60.0, 0.2, 0.0])) is None


def test_a_record_of_any_length_has_a_decay():
    law, parameters = CASES[0]
    late = wave_of_law(np.array([0.0, 2000.0, 4000.0]), law, parameters)
    assert np.all(np.isfinite(late))
    assert abs(late[2]) < 1e-300
