"""The maximum of a likelihood that is not made of poles."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from modal_id.solve import maximum, shortened


def exponential(rate, size, t, sd):
    """Equations and moves of ``size exp(-rate t)`` fitted to its own noise-free values."""
    y = size * np.exp(-rate * t)

    def model(p):
        return p[1] * np.exp(-p[0] * t)

    def equations(p):
        slopes = np.stack([-t * model(p), np.exp(-p[0] * t)], axis=1) / sd
        return slopes.T @ slopes, slopes.T @ (y - model(p)) / sd

    def moved(p, step):
        def trial(shorter):
            better = np.sum((y - model(p + shorter)) ** 2) < np.sum((y - model(p)) ** 2)
            return p + shorter if better else None

        return shortened(step, trial)

    return equations, moved


@given(rate=st.floats(0.2, 5.0), size=st.floats(0.5, 2.0), far=st.floats(0.5, 2.0))
def test_it_is_found_from_afar_with_the_covariance_of_theory(rate, size, far):
    t, sd = np.linspace(0.0, 2.0, 200), 0.01
    found = maximum(np.array([far * rate, far * size]), *exponential(rate, size, t, sd))
    assert found is not None
    p, covariance = found
    error = (p - [rate, size]) / np.sqrt(np.diag(covariance))
    assert np.max(np.abs(error)) < 0.05, "a step of a thirtieth of a standard deviation ends the search"
    slopes = np.stack([-t * size * np.exp(-rate * t), np.exp(-rate * t)], axis=1) / sd
    np.testing.assert_allclose(covariance, np.linalg.inv(slopes.T @ slopes), rtol=0.05)


def test_parameters_that_are_not_determined_have_none():
    def equations(p):
        return np.array([[1.0, 1.0], [1.0, 1.0]]), np.zeros(2)

    assert maximum(np.zeros(2), equations, lambda p, step: None) is None
    assert maximum(None, equations, lambda p, step: None) is None


def test_a_step_that_never_succeeds_is_no_maximum():
    def equations(p):
        return np.eye(1), np.array([1.0])

    assert maximum(np.zeros(1), equations, lambda p, step: None) is None


def test_steps_become_shorter():
    tried = []
    assert shortened(np.ones(1), lambda step: tried.append(float(step[0]))) is None
    np.testing.assert_allclose(np.divide(tried[1:], tried[:-1]), 0.4)
